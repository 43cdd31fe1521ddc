"""What goes wrong with captures and paintings, made on purpose and by known amounts."""
