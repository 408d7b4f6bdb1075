"""What a process needs: interrupts, standard output, files, child processes."""

__all__ = ["children", "files", "interrupts", "output", "scheduling"]
