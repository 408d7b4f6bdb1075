"""The project's configuration files as a whole: which kinds there are, what is wrong in them, what they come to."""
