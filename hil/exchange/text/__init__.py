"""Tables in text files, as loggers, test machines and spreadsheets write them."""
