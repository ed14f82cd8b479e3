//! Settings of the MQTT broker, to which the present values are published.

use std::path::PathBuf;

use survey::Bounds::Within;

use crate::section::section;

section! {
    /// `[mqtt]`, read by `tactus-archive run` only.
    MqttSection, "mqtt" {
        /// Host of the broker.
        host: String;
        /// Its port; 1883 if not given, 8883 with `ca`.
        port: Option<u16>, in Within(1.0, 65_535.0);
        /// Certificates (PEM) of the authorities that may issue the certificate of the broker.
        ca: Option<PathBuf>;
        /// The user at the broker.
        user: Option<String>;
        /// A file with the password.
        password_file: Option<PathBuf>;
        /// Period of the messages, s.
        every_s: f64 = 10.0, in Within(1.0, 3600.0);
        /// First part of the topics on which Home Assistant looks for devices; none are announced without it.
        home_assistant: Option<String>;
    }
}
