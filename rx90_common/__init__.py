"""What every room shares: errors, checked configuration files, data folders, compilation, tick rates."""
