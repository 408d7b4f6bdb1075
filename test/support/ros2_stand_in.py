"""The two verbs of the `ros2` command line that docs/ uses, for an environment without it.

    ros2_stand_in.py topic pub --once -w COUNT --keep-alive SECONDS TOPIC TYPE YAML
    ros2_stand_in.py service call SERVICE TYPE YAML

As the real one, `topic pub --once -w COUNT` waits for as many subscriptions and goes some time after it has sent.
"""

import importlib
import sys
import time
from typing import Any

import rclpy
import yaml

_TIMEOUT = 60.0  # s


def interface(name: str) -> Any:
    package, kind, one = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), one)


def filled(message: Any, values: dict[str, Any]) -> Any:
    for name, value in values.items():
        kind = message.get_fields_and_field_types()[name]
        if isinstance(value, dict):
            filled(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            element = interface(kind.removeprefix("sequence<").removesuffix(">").replace("/", "/msg/"))
            setattr(message, name, [filled(element(), one) for one in value])
        else:
            setattr(message, name, value)
    return message


def main() -> int:
    *verb, name, kind, text = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node("ros2_stand_in")
    deadline = time.monotonic() + _TIMEOUT
    if verb[:4] == ["topic", "pub", "--once", "-w"]:
        wanted, option, seconds = int(verb[4]), *verb[5:]
        assert option == "--keep-alive", verb
        publisher = node.create_publisher(interface(kind), name, 10)
        while publisher.get_subscription_count() < wanted and time.monotonic() < deadline:
            time.sleep(0.05)
        publisher.publish(filled(interface(kind)(), yaml.safe_load(text)))
        time.sleep(float(seconds))
    else:
        assert verb == ["service", "call"], verb
        client = node.create_client(interface(kind), name)
        client.wait_for_service(_TIMEOUT)
        future = client.call_async(filled(interface(kind).Request(), yaml.safe_load(text)))
        rclpy.spin_until_future_complete(node, future, timeout_sec=_TIMEOUT)
        print(future.result())
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
