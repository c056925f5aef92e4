"""Sources of frame sets: capture folders, replayed captures, GenICam cameras; and the belt's encoder."""
