"""From the images of several cameras to frame sets: clocks, trigger instants, exposures, the belt's position."""
