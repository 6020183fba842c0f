"""How many sessions tell strategies apart."""
