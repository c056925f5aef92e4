"""The operator's page and the programming interface behind it: HTTP and WebSocket."""
