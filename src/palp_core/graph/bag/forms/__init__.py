"""What a bag can become, a form a module with a function ``write``."""
