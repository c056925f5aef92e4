"""What one prints or projects."""
