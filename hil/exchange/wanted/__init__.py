"""What a user says of the columns and rows: units, sums of columns, the first and last time, a second file."""
