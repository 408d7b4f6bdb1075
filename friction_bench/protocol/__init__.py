"""What goes over the serial line: frames, messages, the port and its errors."""

__all__ = ["codec", "errors", "messages", "serial_port"]
