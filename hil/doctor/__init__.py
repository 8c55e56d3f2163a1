"""Check a stand: its link, its drive, its stop path, its signs and its lock."""
