"""What builds the problems of each benchmark family: a module for each."""
