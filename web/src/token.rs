//! The access token of the page: reading requires it, because every user of this machine can connect to its ports.

use std::fmt;
use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Random bytes of a token.
const BYTES: usize = 32;

/// A secret of 64 hexadecimal digits, or the content of a file.
#[derive(Clone)]
pub struct Token(String);

/// Why there is no token.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// The system gives no random bytes.
    #[error("no random bytes from /dev/urandom")]
    Random(#[source] std::io::Error),
    /// The file cannot be read.
    #[error("token file {0} cannot be read")]
    Unreadable(PathBuf, #[source] std::io::Error),
    /// Others may read the file.
    #[error("token file {0} can be read by others; run `chmod 600 {0}`")]
    Open(PathBuf),
    /// The content is not a token.
    #[error(
        "token file {0} must hold 32 to 256 letters and digits on one line, e.g. of `openssl rand -hex 32`"
    )]
    Content(PathBuf),
}

impl Token {
    /// A new random token of 64 hexadecimal digits.
    ///
    /// # Errors
    /// The system gives no random bytes.
    pub fn random() -> Result<Self, TokenError> {
        let mut bytes = [0; BYTES];
        std::fs::File::open("/dev/urandom")
            .and_then(|mut source| source.read_exact(&mut bytes))
            .map_err(TokenError::Random)?;
        Ok(Self(
            bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
        ))
    }

    /// The content of a file that only its owner can read. A credential that systemd passes is accepted with any mode.
    ///
    /// # Errors
    /// A file that cannot be read, that others can read, or that holds no token.
    pub fn from_file(path: &Path) -> Result<Self, TokenError> {
        let unreadable = |error| TokenError::Unreadable(path.to_owned(), error);
        let mode = std::fs::metadata(path)
            .map_err(unreadable)?
            .permissions()
            .mode();
        let passed = std::env::var_os("CREDENTIALS_DIRECTORY");
        let is_passed = passed.is_some_and(|folder| path.parent() == Some(Path::new(&folder)));
        if mode & 0o077 != 0 && !is_passed {
            return Err(TokenError::Open(path.to_owned()));
        }
        let text = std::fs::read_to_string(path).map_err(unreadable)?;
        let text = text.trim();
        let good = text.chars().all(|c| c.is_ascii_alphanumeric());
        if !good || !(32..=256).contains(&text.len()) {
            return Err(TokenError::Content(path.to_owned()));
        }
        Ok(Self(text.to_owned()))
    }

    pub(crate) fn text(&self) -> &str {
        &self.0
    }

    /// Compares in a time that does not depend on the content.
    pub(crate) fn is(&self, other: &[u8]) -> bool {
        let own = self.0.as_bytes();
        let different = own.iter().zip(other).fold(0, |sum, (a, b)| sum | (a ^ b));
        own.len() == other.len() && different == 0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(secret)")
    }
}
