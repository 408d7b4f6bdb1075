"""Requests to the services that rclpy gives every node, where it would fail: refused in an answer."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from type_description_interfaces.srv import GetTypeDescription

from rx90_common.base.quoting import quoted

_TYPES = [kind.value for kind in Parameter.Type]
_TYPE_HASH = re.compile(r"RIHS01_[0-9a-f]{64}")


def answer_all_requests(node: Node) -> None:
    """Let services refuse what would leave a request without an answer, or forge lines of the log.

    rclpy crashes on a value of a type that does not exist; rcl prints a type hash unchanged, with its line breaks.
    """
    for service in node.services:
        if service.srv_type in (SetParameters, SetParametersAtomically):
            service.callback = partial(_set_parameters, service.callback)
        elif service.srv_type is GetTypeDescription:
            service.callback = partial(_describe_type, service.callback)


def _set_parameters(set_parameters: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
    for parameter in request.parameters:
        kind = parameter.value.type
        if kind not in _TYPES:
            reason = f"parameter {quoted(parameter.name)} has a value of type {kind}; accepted: 0 to {max(_TYPES)}"
            result = SetParametersResult(successful=False, reason=reason)
            if isinstance(response, SetParametersAtomically.Response):
                response.result = result
            else:
                response.results = [result] * len(request.parameters)
            return response
    return set_parameters(request, response)


def _describe_type(describe: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
    if _TYPE_HASH.fullmatch(request.type_hash):
        return describe(request, response)
    response.failure_reason = (
        f"type_hash is {quoted(request.type_hash)}; accepted: RIHS01_ and 64 digits"
    )
    return response
