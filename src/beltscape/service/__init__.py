"""The service: operator's page, HTTP interface, live stream and access control of a running plant."""
