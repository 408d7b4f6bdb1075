"""What a process needs: interrupts, standard output, files, child processes."""

__all__ = ["children", "exit_code", "files", "interrupts", "output", "scheduling", "threads"]
