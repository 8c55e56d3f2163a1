"""The simulated stand: a plant in continuous time and a servo with imperfect sensors around it."""
