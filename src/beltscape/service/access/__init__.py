"""Access control: users, sessions and keys, limits on requests, and the audit log.

`install` puts it into an application: a `guard` checks every request before any of the `routes`. `access`
joins `accounts`, `passwords`, `sessions` and the log of `audit` in one `database`, with `throttle` and limits
on `connections`.
"""

from beltscape.service.access.access import Access
from beltscape.service.access.accounts import Role, User, get_address, get_socket_user, require_role
from beltscape.service.access.install import install_access
from beltscape.service.settings import AccessSettings, LimitSettings

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
