"""Report: tables of many cells as CSV and Markdown, and the pages with 3D views, tables and plots of a dataset."""
