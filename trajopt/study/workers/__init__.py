"""Tasks in separate processes behind the interface of `concurrent.futures`, their records and display."""
