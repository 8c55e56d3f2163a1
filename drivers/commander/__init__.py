"""SimpleFOC boards over Commander."""
