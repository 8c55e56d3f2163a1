"""Commands over many recordings."""
