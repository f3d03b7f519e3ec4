"""Records to bytes and to text: ``cli.report_files`` chooses the module."""
