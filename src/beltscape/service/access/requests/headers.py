"""Security headers of every response, and the content security policy."""

from __future__ import annotations

from starlette.types import Message, Send

_ALWAYS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), payment=(), usb=(), serial=()",
}


def build_policy(script_hashes: tuple[str, ...] = ()) -> str:
    """Return the content security policy: own resources only, inline scripts only with the given sha256-… hashes."""
    scripts = " ".join(["'self'", *(f"'{h}'" for h in script_hashes)])
    return (
        f"default-src 'none'; script-src {scripts}; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
        "connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    )


def add_security_headers(send: Send, content_policy: str, *, https: bool) -> Send:
    """Return ``send`` that adds the headers to every response; its own caching header and content policy are kept."""
    policy = (b"content-security-policy", content_policy.encode())
    added = dict(_ALWAYS)
    if https:
        added["strict-transport-security"] = "max-age=31536000"
    pairs = [(name.encode(), value.encode()) for name, value in added.items()]

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            own = [(name, value) for name, value in message.get("headers", []) if name.lower() != b"server"]
            if not any(name.lower() == b"cache-control" for name, _ in own):
                own.append((b"cache-control", b"no-store"))
            if not any(name.lower() == policy[0] for name, _ in own):
                own.append(policy)
            message = {**message, "headers": [*own, *pairs]}
        await send(message)

    return send_with_headers
