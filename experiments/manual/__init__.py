"""Studies measure what README and manual show; the pages are written from what they stored.

Other tables are read off the sources: options, functions, assumptions, and the documents and methods that the code
names.
"""
