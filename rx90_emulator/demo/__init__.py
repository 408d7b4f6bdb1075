"""The demonstration: the whole suite run on the reference task, compared and reported."""
