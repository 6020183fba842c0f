"""What an operator does with a session: in which order phantoms come, and opening a sealed one."""
