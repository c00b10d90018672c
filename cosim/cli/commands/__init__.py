"""The commands of `cosim`, a module each; `cosim.cli.main` finds every module that has a COMMAND."""
