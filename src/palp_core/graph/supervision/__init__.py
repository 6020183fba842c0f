"""The processes of a graph: started, watched, restarted, ended."""
