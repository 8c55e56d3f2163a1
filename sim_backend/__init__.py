"""The simulated stand: a plant in continuous time, and around it a servo with imperfect sensors."""
