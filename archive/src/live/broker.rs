//! Publishes the newest messages. A new connection receives the newest message of every topic. A few messages are in
//! flight at a time, and the next ones are sent when the broker has acknowledged these: a broker that is slow, frozen
//! or offline misses messages and never receives old ones.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use rumqttc::Outgoing;
use rumqttc::Transport;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{
    ConnectReturnCode, DisconnectReasonCode, LastWill, LastWillProperties, Packet, PubAckReason,
    PublishProperties,
};
use rumqttc::v5::{AsyncClient, ConnectionError, Event, MqttOptions, StateError};
use tokio::time::{sleep, timeout};

use super::LiveSettings;
use super::latest::{Latest, Message};
use super::topics::Topics;

/// Maximum number of messages in flight.
const WINDOW: usize = 16;
/// Seconds after which an idle connection is tested.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// A connection without traffic for this much longer is closed.
const GRACE: Duration = Duration::from_secs(10);
/// Longest wait after failures.
const LONGEST: Duration = Duration::from_secs(60);
const CONTENT: &str = "application/json";

/// A broker and how it is reached.
pub(super) struct Broker {
    place: String,
    ca: String,
    client: String,
    options: MqttOptions,
    kept_s: u32,
}

impl Broker {
    pub(super) fn new(
        settings: &LiveSettings,
        password: Option<String>,
        transport: Transport,
        topics: &Topics,
        kept: Duration,
    ) -> Self {
        let client = format!("tactus-{}-{}", settings.owner.site, settings.owner.daq);
        let mut options = MqttOptions::new(&client, &settings.host, settings.port);
        let will = Topics::offline("tactus-archive has ended, or its connection to the broker");
        let about = LastWillProperties {
            delay_interval: None,
            payload_format_indicator: Some(1),
            message_expiry_interval: None,
            content_type: Some(CONTENT.to_owned()),
            response_topic: None,
            correlation_data: None,
            user_properties: Vec::new(),
        };
        options
            .set_transport(transport)
            .set_keep_alive(KEEP_ALIVE)
            .set_last_will(LastWill::new(
                topics.status(),
                will.payload,
                QoS::AtLeastOnce,
                true,
                Some(about),
            ));
        if let Some(user) = &settings.user {
            options.set_credentials(user, password.unwrap_or_default());
        }
        Self {
            place: format!("{}:{}", settings.host, settings.port),
            ca: match &settings.ca {
                Some(path) => path.display().to_string(),
                None => String::new(),
            },
            client,
            options,
            kept_s: u32::try_from(kept.as_secs()).unwrap_or(u32::MAX),
        }
    }

    fn about(&self, message: &Message) -> PublishProperties {
        PublishProperties {
            payload_format_indicator: Some(1),
            content_type: Some(CONTENT.to_owned()),
            message_expiry_interval: (!message.lasting).then_some(self.kept_s),
            ..PublishProperties::default()
        }
    }

    /// The cause of the end of a connection, and the remedy.
    fn cause(&self, fault: &ConnectionError) -> String {
        let place = &self.place;
        let cause = survey::error_chain(fault);
        match fault {
            ConnectionError::ConnectionRefused(
                ConnectReturnCode::BadUserNamePassword | ConnectReturnCode::NotAuthorized,
            ) => format!(
                "{place} refuses the login: correct mqtt.user and mqtt.password_file ({cause})"
            ),
            ConnectionError::ConnectionRefused(
                ConnectReturnCode::RefusedProtocolVersion
                | ConnectReturnCode::UnsupportedProtocolVersion,
            ) => format!("{place} is not an MQTT 5 broker ({cause})"),
            ConnectionError::MqttState(StateError::ServerDisconnect {
                reason_code: DisconnectReasonCode::SessionTakenOver,
                ..
            }) => format!(
                "{place}: another client has the name {}: two machines use the same site and daq",
                self.client
            ),
            ConnectionError::Tls(_) => format!(
                "no trusted connection to {place}: its certificate must be issued by {} for this host name ({cause})",
                self.ca
            ),
            ConnectionError::Io(_) => {
                format!(
                    "cannot reach {place}; it may be down, or mqtt.host is the wrong address ({cause})"
                )
            }
            _ => format!("{place}: {cause}"),
        }
    }
}

/// Publishes for ever; reports when the connection to the broker is lost and restored.
pub(super) async fn deliver(broker: &Broker, latest: &Latest) {
    let (mut wait, mut before) = (Duration::from_secs(1), String::new());
    loop {
        let mut connected = false;
        let why = connection(broker, latest, &mut || {
            connected = true;
            eprintln!("tactus-archive: mqtt: connected to {}", broker.place);
        })
        .await;
        if connected {
            (wait, before) = (Duration::from_secs(1), String::new());
        }
        if why != before {
            eprintln!(
                "tactus-archive: mqtt: {why}; the connection is tried again until it succeeds"
            );
            before = why;
        }
        sleep(wait).await;
        wait = (2 * wait).min(LONGEST);
    }
}

/// Serves one connection; returns why it ended.
async fn connection(broker: &Broker, latest: &Latest, connected: &mut dyn FnMut()) -> String {
    let (client, mut events) = AsyncClient::new(broker.options.clone(), WINDOW);
    // number of the message that was sent, by topic
    let mut sent: BTreeMap<String, u64> = BTreeMap::new();
    let (mut queued, mut under_way) = (VecDeque::new(), BTreeMap::new());
    let mut refused = BTreeSet::new();
    let (mut open, mut silence) = (false, KEEP_ALIVE + GRACE);
    loop {
        if open && queued.is_empty() && under_way.is_empty() {
            for (topic, number, message) in latest.unsent(&sent, WINDOW) {
                let about = broker.about(&message);
                let taken = client.try_publish_with_properties(
                    &topic,
                    QoS::AtLeastOnce,
                    true,
                    message.payload,
                    about,
                );
                if let Err(fault) = taken {
                    return format!("{}: {topic}: {fault}", broker.place);
                }
                sent.insert(topic.clone(), number);
                queued.push_back(topic);
            }
        }
        let idle = open && queued.is_empty() && under_way.is_empty();
        let event = tokio::select! {
            event = timeout(silence, events.poll()) => event,
            () = latest.changed(), if idle => continue,
        };
        match event {
            Err(_) => {
                return format!(
                    "{} did not reply within {} s",
                    broker.place,
                    silence.as_secs()
                );
            }
            Ok(Err(fault)) => return broker.cause(&fault),
            Ok(Ok(Event::Incoming(Packet::ConnAck(answer)))) => {
                // a broker may request another interval
                let asked = answer.properties.and_then(|about| about.server_keep_alive);
                silence = asked.map_or(KEEP_ALIVE, |s| Duration::from_secs(s.into())) + GRACE;
                open = true;
                connected();
            }
            Ok(Ok(Event::Outgoing(Outgoing::Publish(id)))) => {
                if let Some(topic) = queued.pop_front() {
                    under_way.insert(id, topic);
                }
            }
            Ok(Ok(Event::Incoming(Packet::PubAck(answer)))) => {
                let taken = matches!(
                    answer.reason,
                    PubAckReason::Success | PubAckReason::NoMatchingSubscribers
                );
                if let Some(topic) = under_way.remove(&answer.pkid)
                    && !taken
                    && refused.insert(topic.clone())
                {
                    eprintln!(
                        "tactus-archive: mqtt: {} refuses {topic}: {:?}; the user '{}' needs the right to write it",
                        broker.place,
                        answer.reason,
                        broker
                            .options
                            .credentials()
                            .map_or_else(String::new, |login| login.username)
                    );
                }
            }
            Ok(Ok(_)) => {}
        }
    }
}
