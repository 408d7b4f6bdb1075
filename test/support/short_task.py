"""A short line, so that a run takes milliseconds."""

SHORT_TASK = """
line:
  start: [0.6, -0.3, 0.2]
  end: [0.6034, -0.2808, 0.1955]
  speed: 0.1
  acceleration: 2.0
  tool_rpy_degrees: [0.0, 180.0, 0.0]
  rest_before: 0.05
  rest_after: 0.05
"""
