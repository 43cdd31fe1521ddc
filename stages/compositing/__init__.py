"""What `render` writes for compositing programs beyond plain frames."""
