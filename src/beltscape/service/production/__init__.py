"""Production beside the measurement: figures, the belt scale's counter, reports and their mail."""
