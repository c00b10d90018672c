"""How far from the truth a coupled run is: certified errors, and the reference solution without coupling."""
