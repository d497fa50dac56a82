"""Something to look at: worlds and recordings as triangles, pictures, films and web pages."""
