"""The models of the coupling, and the terms that they are made of."""
