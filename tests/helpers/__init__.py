"""What several tests share: small scenes and data sets, networks of a small size, and ways to run the workflow and a browser."""
