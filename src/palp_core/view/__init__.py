"""The live page of any graph in the browser: data, permissions, server, pages."""
