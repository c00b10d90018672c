"""The command line `cosim`: `main` reads the commands, and each command is a module of its own."""
