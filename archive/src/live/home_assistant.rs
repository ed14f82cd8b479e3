//! The message that makes Home Assistant show a machine as a device: state, health, frames, each alarm, each quantity
//! of each region. Its templates extract the values from the other topics (MQTT discovery by device, which needs Home
//! Assistant 2024.11 or later).

use std::collections::BTreeMap;
use std::time::Duration;

use dbus::json::{Alarm, Status};
use imaging::quantities::{LoadUnit, Quantity};
use serde_json::{Value, json};

use super::latest::Message;
use crate::upload::Owner;

/// Builds the announcement of a machine.
#[derive(Debug)]
pub(super) struct HomeAssistant {
    topic: String,
    /// `tactus_SITE_DAQ`.
    device: String,
    /// Name of the device for people.
    name: String,
    /// Prefix of the machine's topics.
    base: String,
    kept_s: u64,
    /// Entities so far. An entity is kept while it has no value.
    entities: BTreeMap<String, Value>,
}

impl HomeAssistant {
    pub(super) fn new(prefix: String, owner: &Owner, base: String, kept: Duration) -> Self {
        let device = format!("tactus_{}_{}", owner.site, owner.daq);
        Self {
            topic: format!("{}/device/{device}/config", prefix.trim_end_matches('/')),
            name: format!("Tactus {}/{}", owner.site, owner.daq),
            device,
            base,
            kept_s: kept.as_secs(),
            entities: BTreeMap::new(),
        }
    }

    /// Topic and message, with everything that is or was reported.
    pub(super) fn announcement(
        &mut self,
        status: &Status,
        alarms: &[Alarm],
        quantities: &Option<Value>,
    ) -> (String, Message) {
        self.add(
            "state",
            "sensor",
            "State",
            "status",
            "{{ value_json.state }}",
            json!({}),
        );
        let problem = json!({"device_class": "problem"});
        let template = "{{ 'OFF' if value_json.well else 'ON' }}";
        self.add(
            "health",
            "binary_sensor",
            "Health",
            "health",
            template,
            problem.clone(),
        );
        let template = "{{ value_json.frames_durable if value_json else None }}";
        self.add(
            "frames",
            "sensor",
            "Frames of the session",
            "session",
            template,
            json!({}),
        );
        for alarm in alarms {
            let name = &alarm.name;
            // an alarm that cannot be evaluated is unknown, not off
            let template =
                "{{ 'ON' if value_json.active else 'OFF' if value_json.level == 'ok' else None }}";
            let label = format!("Alarm {name}");
            let (id, topic) = (format!("alarm_{name}"), format!("alarm/{name}"));
            self.add(
                &id,
                "binary_sensor",
                &label,
                &topic,
                template,
                problem.clone(),
            );
        }
        let regions = quantities
            .as_ref()
            .and_then(|found| found["regions"].as_array());
        let of = match quantities.as_ref().map(|found| &found["unit"]) {
            Some(unit) if unit == "pressure" => LoadUnit::Pressure,
            _ => LoadUnit::RelativeLoss,
        };
        for region in regions.into_iter().flatten() {
            let (Some(name), Some(values)) =
                (region["name"].as_str(), region["values"].as_object())
            else {
                continue;
            };
            for quantity in values.keys().filter_map(|name| Quantity::from_name(name)) {
                let word = quantity.name();
                let template = format!(
                    "{{% set r = value_json.regions | selectattr('name', 'eq', '{name}') | list if value_json else [] %}}\
                     {{{{ r[0]['values']['{word}'] | default(None) if r else None }}}}"
                );
                let label = format!("{name}: {}", quantity.words());
                let more =
                    json!({"unit_of_measurement": quantity.unit(of), "state_class": "measurement"});
                self.add(
                    &format!("{name}_{word}"),
                    "sensor",
                    &label,
                    "quantities",
                    &template,
                    more,
                );
            }
        }
        let message = json!({
            "device": {
                "identifiers": [self.device],
                "name": self.name,
                "manufacturer": "Tactus",
                "model": if status.simulated { "conductive sheet (SIMULATED)" } else { "conductive sheet" },
                "sw_version": status.version,
            },
            "origin": {"name": "tactus-archive", "sw_version": env!("CARGO_PKG_VERSION")},
            "availability": [{
                "topic": format!("{}/status", self.base),
                "value_template": "{{ 'offline' if value_json.state == 'offline' else 'online' }}",
            }],
            "components": self.entities,
        });
        let message = Message {
            payload: message.to_string(),
            lasting: true,
        };
        (self.topic.clone(), message)
    }

    /// Adds an entity; `more` is merged into its description.
    fn add(
        &mut self,
        id: &str,
        platform: &str,
        name: &str,
        topic: &str,
        template: &str,
        more: Value,
    ) {
        let mut entity = json!({
            "platform": platform,
            "name": name,
            "unique_id": format!("{}_{id}", self.device),
            "state_topic": format!("{}/{topic}", self.base),
            "value_template": template,
            "expire_after": self.kept_s,
        });
        if let (Value::Object(entity), Value::Object(more)) = (&mut entity, more) {
            entity.extend(more);
        }
        self.entities.insert(id.to_owned(), entity);
    }
}
