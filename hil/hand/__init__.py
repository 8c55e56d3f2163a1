"""The file of a hand: many motors on one bus, each with an ordinary stand that follows from it."""
