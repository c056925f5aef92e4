"""Access control: users, sessions and keys, limits on requests, and the audit log."""

from beltscape.service.access.access import Access
from beltscape.service.access.identity.roles import Role, User
from beltscape.service.access.install import install_access
from beltscape.service.access.requests.dependencies import get_address, get_socket_user, require_role
from beltscape.service.access.settings import AccessSettings, LimitSettings

__all__ = [
    "Access",
    "AccessSettings",
    "LimitSettings",
    "Role",
    "User",
    "get_address",
    "get_socket_user",
    "install_access",
    "require_role",
]
