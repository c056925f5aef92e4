"""Who may come in, what a request may look like, and the log of who did what."""

from beltscape.service.access.access import Access
from beltscape.service.access.depends import address_of, needs, socket_user
from beltscape.service.access.install import install
from beltscape.service.access.roles import Role, User
from beltscape.service.access.settings import AccessSettings, LimitSettings

__all__ = [
    "Access",
    "AccessSettings",
    "LimitSettings",
    "Role",
    "User",
    "address_of",
    "install",
    "needs",
    "socket_user",
]
