//! Settings of the MQTT broker, to which the present values are published.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// `[mqtt]`, read by `tactus-archive run` only.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MqttSection {
    /// Host of the broker.
    pub host: String,
    /// Its port; 1883 if not given, 8883 with `ca`.
    pub port: Option<u16>,
    /// Certificates (PEM) of the authorities that may issue the certificate of the broker.
    pub ca: Option<PathBuf>,
    /// The user at the broker.
    pub user: Option<String>,
    /// A file with the password.
    pub password_file: Option<PathBuf>,
    /// Period of the messages, s.
    pub every_s: f64,
    /// First part of the topics on which Home Assistant looks for devices; none are announced without it.
    pub home_assistant: Option<String>,
}

impl Default for MqttSection {
    fn default() -> Self {
        Self {
            host: String::new(),
            port: None,
            ca: None,
            user: None,
            password_file: None,
            every_s: 10.0,
            home_assistant: None,
        }
    }
}
