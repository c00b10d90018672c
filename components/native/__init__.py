"""C from the very functions of a component: traced, printed, compiled for every platform."""
