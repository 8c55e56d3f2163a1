"""The import and export of tables, with their units."""
