"""Present results: tables for the terminal, JSON objects, HTML pages and figures."""
