"""One comparison of how two views show a surface: transfers from view to view, and a score."""
