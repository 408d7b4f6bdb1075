"""The services with which others set a node's parameters: whatever is asked for is answered."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter

from rx90_common.base.quoting import quoted

_TYPES = {kind.value for kind in Parameter.Type}


def answer_all_requests(node: Node) -> None:
    """Let the services refuse values of a type that does not exist, which rclpy does not survive."""
    for service in node.services:
        if service.srv_type is SetParameters:
            service.callback = _one_by_one(service.callback)
        elif service.srv_type is SetParametersAtomically:
            service.callback = _all_or_none(service.callback)


def _one_by_one(set_parameters: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def answer(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            refused = _refusal(parameter)
            if refused is None:
                set_parameters(SetParameters.Request(parameters=[parameter]), response)
            else:
                response.results.append(refused)
        return response

    return answer


def _all_or_none(set_parameters: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def answer(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            refused = _refusal(parameter)
            if refused is not None:
                response.result = refused
                return response
        return set_parameters(request, response)

    return answer


def _refusal(parameter: Any) -> SetParametersResult | None:
    kind = parameter.value.type
    if kind in _TYPES:
        return None
    reason = f"parameter {quoted(parameter.name)} has a value of type {kind}; accepted: {min(_TYPES)} to {max(_TYPES)}"
    return SetParametersResult(successful=False, reason=reason)
