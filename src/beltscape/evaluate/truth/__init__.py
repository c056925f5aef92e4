"""The truth of simulated scenes, read from files and brought onto a grid."""
