"""How fast each part is on this machine; each module gives the rows of a table."""
