"""Reports of finished runs: HTML, Markdown, CSV and figures."""
