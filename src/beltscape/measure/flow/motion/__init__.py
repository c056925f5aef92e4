"""The motion of belt and load: registration of heights, encoder, prediction."""
