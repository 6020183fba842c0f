"""The pages, on NiceGUI: all that they show is text, and who may press what is decided elsewhere."""
