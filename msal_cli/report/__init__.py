"""Records to bytes and to words: a module per format, which ``cli.report_files`` chooses."""
