"""One form for what problems say in many styles; structure is recognised in that form only."""
