"""Import and export of tables with units, and export of the identified coupling."""
