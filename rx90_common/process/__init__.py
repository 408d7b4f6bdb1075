"""What a process needs: interrupts, standard output, child processes."""

__all__ = ["children", "exit_code", "interrupts", "output"]
