"""Alarms to a syslog server: RFC 5424 messages over UDP (RFC 5426), TCP (RFC 6587) or TLS (RFC 5425).

This is own code, because the libraries for Python send from the caller's thread, wait for the server, and do
not say what they lost. The standard library's handler knows RFC 3164 only.
"""
