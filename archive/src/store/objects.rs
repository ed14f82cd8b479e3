//! A bucket of an S3-compatible server as a store.

use std::fs::File;
use std::io::{Error, Read, Seek};
use std::sync::Arc;
use std::time::Duration;

use logbook::sha256_of;
use rusty_s3::{Bucket, Credentials, S3Action, UrlStyle};
use ureq::http::{Response, StatusCode};
use ureq::tls::{Certificate, RootCerts, TlsConfig};
use ureq::{Agent, Body, SendBody};

use super::{PartName, Store, StoreError, Stored};

/// Validity of a signature: the time within which the server must begin to process a request.
const SIGNED: Duration = Duration::from_secs(900);
/// Timeout of a connection, of the reply to a request, and between two blocks.
const ANSWER: Duration = Duration::from_secs(60);
/// Maximum size of a single upload, bytes: the limit of S3.
const LARGEST: u64 = 5 << 30;

/// Access to a bucket.
#[derive(Debug, Clone)]
pub struct BucketAccess {
    /// Address of the server: `https://HOST[:PORT]`; `http` is allowed to this machine only.
    pub endpoint: String,
    /// Region for which requests are signed.
    pub region: String,
    /// The bucket, addressed as a folder of the server.
    pub bucket: String,
    /// Certificates (DER) of the authorities that may issue the server's certificate.
    pub authorities: Vec<Vec<u8>>,
    /// Name of the key.
    pub key: String,
    /// The key.
    pub secret: String,
}

/// A bucket. A part is written with `If-None-Match: *`, so that the server does not replace an existing one.
#[derive(Debug)]
pub struct Objects {
    bucket: Bucket,
    credentials: Credentials,
    agent: Agent,
    place: String,
}

impl Objects {
    /// The store in an existing bucket.
    ///
    /// # Errors
    /// An address that cannot or must not be used.
    pub fn new(access: &BucketAccess) -> Result<Self, String> {
        let endpoint = &access.endpoint;
        let url = endpoint.parse().map_err(|fault| {
            format!("'{endpoint}' is not an address: {fault}; write https://HOST")
        })?;
        let bucket = Bucket::new(
            url,
            UrlStyle::Path,
            access.bucket.clone(),
            access.region.clone(),
        )
        .map_err(|fault| {
            format!("'{endpoint}' is not the address of a bucket: {fault}; write https://HOST")
        })?;
        let encrypted = endpoint.starts_with("https://");
        let host = bucket
            .base_url()
            .host_str()
            .unwrap_or_default()
            .trim_matches(['[', ']']);
        if !encrypted && !crate::credentials::is_loopback(host) {
            return Err(format!("'{endpoint}' is another machine: use https"));
        }
        if encrypted && access.authorities.is_empty() {
            return Err(format!(
                "'{endpoint}' needs archive.store_ca, the certificates of its authority"
            ));
        }
        let authorities = access
            .authorities
            .iter()
            .map(|der| Certificate::from_der(der).to_owned());
        let tls = TlsConfig::builder()
            .root_certs(RootCerts::from(authorities))
            .unversioned_rustls_crypto_provider(Arc::new(rustls::crypto::ring::default_provider()))
            .build();
        let agent = Agent::config_builder()
            .tls_config(tls)
            .http_status_as_error(false)
            .max_redirects(0)
            .timeout_connect(Some(ANSWER))
            .timeout_per_read(Some(ANSWER))
            .timeout_per_write(Some(ANSWER))
            .timeout_recv_response(Some(ANSWER))
            .build()
            .new_agent();
        Ok(Self {
            place: format!("{endpoint}/{}", access.bucket),
            credentials: Credentials::new(&access.key, &access.secret),
            bucket,
            agent,
        })
    }

    fn unreachable(&self, fault: ureq::Error) -> StoreError {
        let place = self.place.clone();
        let source = match fault {
            ureq::Error::Io(source) => source,
            ureq::Error::Rustls(source) => Error::other(source),
            other => Error::other(other),
        };
        match crate::credentials::is_about_tls(&source) {
            true => StoreError::Untrusted { place, source },
            false => StoreError::Unreachable { place, source },
        }
    }

    /// The error of an unexpected reply, with the server's own text.
    fn refused(&self, name: &PartName, mut answer: Response<Body>) -> StoreError {
        let status = answer.status();
        let mut text = String::new();
        // the reason is short; an unreadable rest is ignored
        let _ = answer
            .body_mut()
            .as_reader()
            .take(2000)
            .read_to_string(&mut text);
        let reason = tagged(&text, "Code").or_else(|| tagged(&text, "Message"));
        StoreError::Refused {
            place: self.place.clone(),
            name: name.to_string(),
            status: status.as_u16(),
            why: reason
                .unwrap_or_else(|| status.canonical_reason().unwrap_or("no reason").to_owned()),
        }
    }

    fn get(&self, name: &PartName) -> Result<Response<Body>, StoreError> {
        let key = name.to_string();
        let url = self
            .bucket
            .get_object(Some(&self.credentials), &key)
            .sign(SIGNED);
        let answer = self
            .agent
            .get(url.as_str())
            .call()
            .map_err(|fault| self.unreachable(fault))?;
        match answer.status() {
            StatusCode::OK => Ok(answer),
            StatusCode::NOT_FOUND => match self.refused(name, answer) {
                StoreError::Refused { why, .. } if why == "NoSuchKey" => Err(StoreError::Missing {
                    place: self.place.clone(),
                    name: key,
                }),
                other => Err(other),
            },
            _ => Err(self.refused(name, answer)),
        }
    }

    /// The size of a part on the server, if its content has the hash of its name.
    fn read_back(&self, name: &PartName) -> Result<u64, StoreError> {
        let mut answer = self.get(name)?;
        let read = sha256_of(answer.body_mut().with_config().limit(u64::MAX).reader());
        let (found, bytes) = read.map_err(|source| StoreError::Unreachable {
            place: self.place.clone(),
            source,
        })?;
        match found == name.sha256 {
            true => Ok(bytes),
            false => Err(StoreError::Altered {
                place: self.place.clone(),
                name: name.to_string(),
                found,
            }),
        }
    }
}

/// The text of an element of an XML reply.
fn tagged(text: &str, name: &str) -> Option<String> {
    let (_, rest) = text.split_once(&format!("<{name}>"))?;
    let (inner, _) = rest.split_once(&format!("</{name}>"))?;
    Some(inner.trim().to_owned())
}

impl Store for Objects {
    fn put(&self, name: &PartName, from: &mut File) -> Result<Stored, StoreError> {
        let io = |source| StoreError::Io {
            path: name.to_string().into(),
            attempt: "read the part for",
            source,
        };
        from.rewind().map_err(io)?;
        let bytes = from.metadata().map_err(io)?.len();
        if bytes > LARGEST {
            return Err(StoreError::TooLarge {
                place: self.place.clone(),
                name: name.to_string(),
                bytes,
                most: LARGEST,
            });
        }
        let key = name.to_string();
        let mut action = self.bucket.put_object(Some(&self.credentials), &key);
        action.headers_mut().insert("if-none-match", "*");
        let url = action.sign(SIGNED);
        let sent = self
            .agent
            .put(url.as_str())
            .header("if-none-match", "*")
            .header("content-length", bytes)
            .header("content-type", "application/vnd.sqlite3")
            .send(SendBody::from_reader(from));
        let answer = sent.map_err(|fault| self.unreachable(fault))?;
        let existed = match answer.status() {
            status if status.is_success() => false,
            // it exists already; some servers reply as to a conditional GET
            StatusCode::PRECONDITION_FAILED | StatusCode::NOT_MODIFIED => true,
            _ => return Err(self.refused(name, answer)),
        };
        let bytes = self.read_back(name)?;
        Ok(Stored { bytes, existed })
    }

    fn open(&self, name: &PartName) -> Result<Box<dyn Read + '_>, StoreError> {
        let answer = self.get(name)?;
        let body = answer.into_body().into_with_config().limit(u64::MAX);
        Ok(Box::new(body.reader()))
    }

    fn place(&self) -> String {
        self.place.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn address_without_encryption_is_of_this_machine_only() {
        let fault = |endpoint: &str| {
            let access = BucketAccess {
                endpoint: endpoint.into(),
                region: "eu".into(),
                bucket: "b".into(),
                authorities: Vec::new(),
                key: "k".into(),
                secret: "s".into(),
            };
            Objects::new(&access).map(|_| ()).unwrap_err()
        };
        assert!(fault("http://s3.example.org").contains("use https"));
        assert!(fault("https://s3.example.org").contains("archive.store_ca"));
        assert!(fault("s3.example.org").contains("write https://HOST"));
    }

    #[test]
    fn part_above_the_limit_is_refused_and_others_are_not() {
        let store = Objects::new(&BucketAccess {
            endpoint: "http://127.0.0.1:1".into(),
            region: "eu".into(),
            bucket: "b".into(),
            authorities: Vec::new(),
            key: "k".into(),
            secret: "s".into(),
        });
        let store = store.unwrap();
        let name = PartName {
            site: "berlin".into(),
            daq: "bed3".into(),
            session: "m1".into(),
            part: "m1".into(),
            sha256: "0".repeat(64),
        };
        let mut file = tempfile::tempfile().unwrap();
        for (bytes, is_of_one_part) in [(LARGEST + 1, true), (1, false)] {
            file.set_len(bytes).unwrap();
            let error = store.put(&name, &mut file).unwrap_err();
            assert_eq!(error.is_of_one_part(), is_of_one_part, "{error}");
            assert_eq!(error.is_temporary(), !is_of_one_part, "{error}");
        }
    }

    #[test]
    fn reason_of_the_server_is_read_from_its_answer() {
        let text = "<?xml version=\"1.0\"?><Error><Code>NoSuchBucket</Code><Message>none</Message></Error>";
        assert_eq!(tagged(text, "Code").as_deref(), Some("NoSuchBucket"));
        assert_eq!(tagged("gateway", "Code"), None);
    }
}
