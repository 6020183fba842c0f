"""The live page of any graph in the browser: what is shown, who may press what, and the pages."""
