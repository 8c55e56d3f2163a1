"""Tables, pages and pictures of a result."""
