//! Live topics: the daemon's present state, published on an MQTT broker. For display only, not a record: a broker may
//! lose messages, and none is repeated. Runs in a thread of its own; neither this thread nor uploads wait for each
//! other.
//!
//! - **daemon**: queries the daemon over its bus, like any client
//! - **topics**: the messages for its replies; **home_assistant**: the message that announces them to Home Assistant
//! - **latest**: the newest message of each topic
//! - **broker**: publishes them

mod broker;
mod daemon;
mod home_assistant;
mod latest;
mod topics;

use std::path::PathBuf;
use std::time::Duration;

use rumqttc::{TlsConfiguration, Transport};

use crate::credentials::{is_loopback, secret, trusting};
use crate::runtime::runtime;
use crate::upload::Owner;
use broker::Broker;
use latest::Latest;
use topics::Topics;

/// Name of the systemd credential with the password.
const CREDENTIAL: &str = "mqtt-password";
/// Number of periods without a newer message after which the broker deletes a message.
const EXPIRES: u32 = 6;
/// Minimum time for which the broker keeps a message.
const KEPT: Duration = Duration::from_secs(60);

/// Broker, topics and source of the live topics.
#[derive(Debug, Clone)]
pub struct LiveSettings {
    /// Site and machine.
    pub owner: Owner,
    /// Address of the daemon.
    pub daemon: dbus::Address,
    /// Host of the broker.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// Certificates of the authorities that may issue the broker's certificate.
    pub ca: Option<PathBuf>,
    /// The user at the broker.
    pub user: Option<String>,
    /// A file with the password.
    pub password_file: Option<PathBuf>,
    /// Period of the messages.
    pub every: Duration,
    /// First part of the topics on which Home Assistant looks for devices.
    pub home_assistant: Option<String>,
}

impl LiveSettings {
    /// The settings of `[mqtt]`; the error names the key that is wrong.
    pub(crate) fn of(
        mqtt: &config::MqttSection,
        bus: &config::BusSection,
        owner: &Owner,
    ) -> Result<Self, (&'static str, String)> {
        if mqtt.host.is_empty() {
            return Err(("host", "is missing: name the host of the broker".to_owned()));
        }
        if mqtt.ca.is_none() && !is_loopback(&mqtt.host) {
            let text = format!(
                "{} is another machine: give mqtt.ca, the certificates of its authority",
                mqtt.host
            );
            return Err(("host", text));
        }
        if mqtt.user.is_none() && mqtt.password_file.is_some() {
            return Err(("password_file", "needs mqtt.user".to_owned()));
        }
        let prefix = mqtt.home_assistant.as_deref();
        if prefix.is_some_and(|prefix| prefix.is_empty() || prefix.contains(['+', '#', '\0'])) {
            let text = "is not a topic: write for example \"homeassistant\"";
            return Err(("home_assistant", text.to_owned()));
        }
        let daemon = match bus {
            bus if bus.peer => bus.peer_path.clone().map(dbus::Address::Unix),
            bus if bus.system => Some(dbus::Address::System),
            bus if bus.session => Some(dbus::Address::Session),
            _ => None,
        };
        let Some(daemon) = daemon else {
            let text = "needs a bus of the daemon: set one of bus.peer, bus.system, bus.session";
            return Err(("host", text.to_owned()));
        };
        Ok(Self {
            owner: owner.clone(),
            daemon,
            host: mqtt.host.clone(),
            port: mqtt.port.unwrap_or(match mqtt.ca {
                Some(_) => 8883,
                None => 1883,
            }),
            ca: mqtt.ca.clone(),
            user: mqtt.user.clone(),
            password_file: mqtt.password_file.clone(),
            every: survey::duration(mqtt.every_s),
            home_assistant: mqtt.home_assistant.clone(),
        })
    }
}

/// Publishes in a thread of its own until the process ends. Faults of daemon and broker are reported on standard
/// error and do not end the thread.
///
/// # Errors
/// Password or certificates cannot be read, or the thread cannot be started; the text names the key.
pub(crate) fn start(settings: LiveSettings) -> Result<(), String> {
    let password = match settings.user {
        None => None,
        Some(_) => {
            let folder = std::env::var_os("CREDENTIALS_DIRECTORY");
            let file = settings.password_file.as_deref();
            secret(file, CREDENTIAL, folder)
                .map_err(|fault| format!("mqtt.password_file: {fault}"))?
        }
    };
    let transport = match &settings.ca {
        None => Transport::tcp(),
        Some(ca) => {
            let tls = trusting(ca).map_err(|fault| format!("mqtt.ca: {fault}"))?;
            Transport::tls_with_config(TlsConfiguration::from(tls))
        }
    };
    let runtime = runtime().map_err(|fault| fault.to_string())?;
    let kept = settings.every.saturating_mul(EXPIRES).max(KEPT);
    let publish = move || {
        let latest = Latest::default();
        let topics = Topics::new(&settings.owner, settings.home_assistant.clone(), kept);
        let broker = Broker::new(&settings, password, transport, &topics, kept);
        runtime.block_on(async {
            tokio::join!(
                daemon::observe(&settings.daemon, settings.every, topics, &latest),
                broker::deliver(&broker, &latest)
            )
        });
    };
    std::thread::Builder::new()
        .name("mqtt".to_owned())
        .spawn(publish)
        .map_err(|fault| format!("no thread for mqtt: {fault}"))?;
    Ok(())
}
