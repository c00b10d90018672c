"""What the resonance map is made of."""
