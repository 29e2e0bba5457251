"""How functions of one walker become fast functions of many."""
