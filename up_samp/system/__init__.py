"""What the package asks of the operating system: child processes, files, the cache folder."""
