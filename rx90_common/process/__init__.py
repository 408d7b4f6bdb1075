"""What a process needs: interrupts, standard output, exit codes, child processes."""

__all__ = ["children", "interrupts", "output"]
