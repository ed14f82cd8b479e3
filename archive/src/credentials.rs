//! Files with passwords, keys and certificates.

use std::ffi::OsString;
use std::net::IpAddr;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use rustls::{ClientConfig, RootCertStore};

/// Maximum size of a file with a secret, bytes; a larger one is probably a wrong file.
const LONGEST: u64 = 4096;

/// The text of a file, which must not be readable by group and others.
pub(crate) fn private_file(path: &Path) -> Result<String, String> {
    let wrong = |why: &str| format!("{}: {why}", path.display());
    let found = std::fs::metadata(path).map_err(|error| wrong(&error.to_string()))?;
    if !found.is_file() || found.len() > LONGEST {
        return Err(wrong("is not a file with one secret"));
    }
    let mode = found.mode() & 0o777;
    if mode & 0o077 != 0 {
        return Err(wrong(&format!(
            "others may read it (mode {mode:04o}): chmod 0600"
        )));
    }
    text_of(path)
}

/// The secret from a file, or from the systemd credential of this name; `None` if there is neither.
pub(crate) fn secret(
    file: Option<&Path>,
    credential: &str,
    folder: Option<OsString>,
) -> Result<Option<String>, String> {
    match (file, folder) {
        (Some(file), _) => private_file(file).map(Some),
        // systemd restricts access to it
        (None, Some(folder)) => {
            let path = PathBuf::from(folder).join(credential);
            path.exists().then(|| text_of(&path)).transpose()
        }
        (None, None) => Ok(None),
    }
}

fn text_of(path: &Path) -> Result<String, String> {
    let wrong = |why: &str| format!("{}: {why}", path.display());
    let text = std::fs::read_to_string(path).map_err(|error| wrong(&error.to_string()))?;
    match text.trim_end_matches(['\n', '\r']) {
        "" => Err(wrong("is empty")),
        text => Ok(text.to_owned()),
    }
}

/// The certificates of a PEM file.
pub(crate) fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let wrong = |why: &str| format!("{}: {why}", path.display());
    let read = CertificateDer::pem_file_iter(path).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let found = read.map_err(|error| wrong(&survey::error_chain(&error)))?;
    match found.is_empty() {
        true => Err(wrong(
            "holds no certificate in PEM form (`-----BEGIN CERTIFICATE-----`)",
        )),
        false => Ok(found),
    }
}

/// A TLS configuration that trusts only the certificates of a file.
pub(crate) fn trusting(ca: &Path) -> Result<ClientConfig, String> {
    let wrong = |error: rustls::Error| format!("{}: {error}", ca.display());
    let mut roots = RootCertStore::empty();
    for certificate in certificates(ca)? {
        roots.add(certificate).map_err(wrong)?;
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let versions = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(wrong)?;
    Ok(versions.with_root_certificates(roots).with_no_client_auth())
}

/// Whether an error or one of its causes concerns TLS: a certificate that is not trusted, or a peer that does not
/// encrypt.
pub(crate) fn is_about_tls(error: &(dyn std::error::Error + 'static)) -> bool {
    std::iter::successors(Some(error), |cause| cause.source()).any(|cause| {
        let inner = cause.downcast_ref::<std::io::Error>();
        let inner = inner.and_then(std::io::Error::get_ref);
        cause.is::<rustls::Error>() || inner.is_some_and(|inner| inner.is::<rustls::Error>())
    })
}

/// Whether a host is this machine.
pub(crate) fn is_loopback(name: &str) -> bool {
    name == "localhost"
        || name
            .parse::<IpAddr>()
            .is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secret_that_others_may_read_is_refused() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("password");
        std::fs::write(&file, "secret\n").unwrap();
        let allow = |mode| {
            std::fs::set_permissions(&file, std::fs::Permissions::from_mode(mode)).unwrap();
            secret(Some(&file), "archive-password", None)
        };
        assert_eq!(allow(0o600).unwrap().as_deref(), Some("secret"));
        for mode in [0o640, 0o604, 0o644] {
            let text = allow(mode).unwrap_err();
            assert!(text.contains("chmod 0600"), "{text}");
        }
        let missing = secret(Some(&folder.path().join("none")), "x", None).unwrap_err();
        assert!(missing.contains("none"), "{missing}");
    }

    #[test]
    fn credential_of_the_service_is_used_without_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let of = |name| secret(None, name, Some(folder.path().into()));
        assert_eq!(of("archive-password").unwrap(), None);
        std::fs::write(folder.path().join("archive-password"), "a word\n").unwrap();
        assert_eq!(of("archive-password").unwrap().as_deref(), Some("a word"));
    }

    #[test]
    fn file_without_certificates_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("ca.pem");
        std::fs::write(&file, "no certificate").unwrap();
        let text = certificates(&file).unwrap_err();
        assert!(text.contains("ca.pem") && text.contains("PEM"), "{text}");
    }
}
