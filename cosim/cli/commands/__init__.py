"""The commands of `cosim`, a module each: its first line is the help, `add_options` the arguments, `execute` the work."""
