"""What a process needs: interrupts, standard output, child processes."""

__all__ = ["children", "interrupts", "output", "scheduling"]
