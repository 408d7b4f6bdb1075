"""The verbs of `rx90_bag`, one module each, with `add_arguments()` and `main()`."""

__all__ = ["bag", "line", "run"]
