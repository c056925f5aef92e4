from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa

def generate_self_signed_app_certificate(
    private_key: rsa.RSAPrivateKey,
    common_name: str,
    names: dict[str, str],
    subject_alt_names: list[x509.GeneralName],
    extended: list[x509.ObjectIdentifier],
    days: int = 365,
) -> x509.Certificate: ...
