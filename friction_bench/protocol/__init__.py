"""What goes over the serial line: frames, messages, the port and its errors."""
