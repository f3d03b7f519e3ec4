"""Records to bytes and to words: ``cli.report_files`` chooses the module."""
