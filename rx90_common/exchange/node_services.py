"""The services that rclpy gives every node: whatever is asked for is answered."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from type_description_interfaces.srv import GetTypeDescription

from rx90_common.base.quoting import quoted

_TYPES = {kind.value for kind in Parameter.Type}


_TYPE_HASH = re.compile(r"RIHS01_[0-9a-f]{64}")


def answer_all_requests(node: Node) -> None:
    """Let the services refuse what rclpy cannot take.

    It does not survive a value of a type that does not exist. A type hash that is none is printed as it is by rcl, with
    its line breaks.
    """
    for service in node.services:
        if service.srv_type is SetParameters:
            service.callback = _one_by_one(service.callback)
        elif service.srv_type is SetParametersAtomically:
            service.callback = _all_or_none(service.callback)
        elif service.srv_type is GetTypeDescription:
            service.callback = _of_a_type(service.callback)


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


def _of_a_type(describe: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def answer(request: Any, response: Any) -> Any:
        if _TYPE_HASH.fullmatch(request.type_hash):
            return describe(request, response)
        response.successful = False
        response.failure_reason = f"type_hash is {quoted(request.type_hash)}; accepted: RIHS01_ and 64 digits"
        return response

    return answer


def _refusal(parameter: Any) -> SetParametersResult | None:
    kind = parameter.value.type
    if kind in _TYPES:
        return None
    reason = f"parameter {quoted(parameter.name)} has a value of type {kind}; accepted: {min(_TYPES)} to {max(_TYPES)}"
    return SetParametersResult(successful=False, reason=reason)
