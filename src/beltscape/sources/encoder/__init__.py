"""Where the belt is: encoders of every kind behind one call."""
