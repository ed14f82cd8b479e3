//! A certificate authority for tests, and its certificates, made with openssl.

use std::path::Path;
use std::process::Command;

/// An authority: `NAME.pem` and `NAME.key` in the folder.
pub fn authority(folder: &Path, name: &str) {
    run(
        folder,
        &format!(
            "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=test -addext basicConstraints=critical,CA:TRUE \
             -keyout {name}.key -out {name}.pem"
        ),
    );
}

/// A certificate of this machine by an authority: `NAME.crt` and `NAME.key` in the folder.
pub fn issue(folder: &Path, authority: &str, name: &str) {
    run(
        folder,
        &format!(
            "openssl req -newkey rsa:2048 -nodes -subj /CN=localhost -keyout {name}.key -out {name}.csr &&
             printf 'subjectAltName=DNS:localhost,IP:127.0.0.1\\nbasicConstraints=CA:FALSE\\n' > {name}.ext &&
             openssl x509 -req -in {name}.csr -CA {authority}.pem -CAkey {authority}.key -CAcreateserial -days 2 \
             -extfile {name}.ext -out {name}.crt"
        ),
    );
}

fn run(folder: &Path, script: &str) {
    let made = Command::new("sh")
        .current_dir(folder)
        .args(["-c", script])
        .output()
        .unwrap();
    assert!(made.status.success(), "{made:?}");
}
