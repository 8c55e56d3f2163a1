"""Tables of other programs in and out, with their units."""
