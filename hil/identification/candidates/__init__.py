"""Model selection: find the terms that improve the score of a recording."""
