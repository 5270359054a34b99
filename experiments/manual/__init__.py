"""Pages of the manual that are read off the sources: assumptions, and the documents and methods that the code names."""
