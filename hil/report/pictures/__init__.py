"""The pictures of a recording and of an identification: drawn for the page, and written as PNG."""
