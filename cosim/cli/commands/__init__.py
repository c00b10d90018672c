"""The commands of `cosim`, a module each: `SUMMARY` is the help, `add_options` the arguments, `execute` the work."""
