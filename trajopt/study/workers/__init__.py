"""Tasks in processes of their own behind the interface of `concurrent.futures`, their records and display."""
