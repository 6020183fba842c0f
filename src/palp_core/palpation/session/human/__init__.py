"""The experiment with people: who they are allowed to be called, what is asked of them, what is kept."""
