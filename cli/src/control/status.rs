//! `tactus status`: state and health of the daemon on one screen.

use std::io::Write;

use dbus::json::{MapSummary, Recovery, Status};

use crate::connection::Daemon;
use crate::control::health;
use crate::failure::Failure;
use crate::maps::drawing::map_summary;
use crate::output::Printer;

/// The number of the attempt, the missing instruments and the time of the next attempt.
pub(crate) fn attempts(recovery: &Recovery) -> String {
    let tries = match recovery.tries {
        0 => "reconnecting".to_owned(),
        tries => format!("reconnecting, {tries} attempts so far"),
    };
    let next = match (recovery.person, recovery.next_s) {
        (true, _) => "waiting for you: `tactus instruments accept`".to_owned(),
        (false, Some(next)) => format!("the next in {next:.1} s"),
        (false, None) => "one under way".to_owned(),
    };
    format!("{tries}, {next}: {}", recovery.what)
}

fn last_map(map: &MapSummary) -> String {
    let pressed = map.newtons.zip(map.largest_kpa);
    let mut text = format!(
        "frame {}: {}",
        map.sequence,
        map_summary(map.largest_loss.unwrap_or(0.0), pressed, map.noise)
    );
    if let (Some(quality), Some(doubts)) = (&map.quality, &map.doubts) {
        text.push_str(&format!(", {quality}: {doubts}"));
    }
    if map.known == Some(false) {
        text.push_str(", not known to be true (`tactus watch` shows why)");
    }
    if let Some(seconds) = map.reconstruction_s {
        text.push_str(&format!(", computed in {:.3} ms", 1e3 * seconds));
    }
    text
}

pub(crate) async fn run(daemon: &Daemon, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
    let status = daemon.ask("the status", daemon.manager.status()).await?;
    let status = Status::from(status, daemon.address.to_string());
    printer.record(&status, for_a_person)
}

fn for_a_person(status: &Status) -> String {
    let mut lines = health::verdict(&status.health);
    lines.extend([
        format!(
            "state      {}{}",
            status.state,
            if status.simulated {
                "  (SIMULATED)"
            } else {
                ""
            }
        ),
        format!("source     {}", status.source),
        format!("method     {}", status.method),
        match &status.baseline {
            Some(id) => format!("baseline   {id}{}", health::age_of_baseline(&status.health)),
            None => {
                "baseline   none; take all loads off the sheet and run `tactus baseline record`"
                    .to_owned()
            }
        },
    ]);
    let remark = health::remark_on_baseline(&status.baseline_remarks);
    lines.extend(remark.map(|text| format!("           warning: {text}")));
    match &status.session {
        None => lines.push("session    none; `tactus start` starts one".to_owned()),
        Some(session) => {
            lines.push(format!(
                "session    {} ({}, {}): {} frames recorded",
                session.id, session.kind, session.state, session.frames_durable,
            ));
            if let Some(map) = &session.map {
                lines.push(format!("map        {}", last_map(map)));
            }
        }
    }
    lines.extend(health::for_a_person(&status.health));
    if let Some(recovery) = &status.recovery {
        lines.push(format!("rig        {}", attempts(recovery)));
    }
    lines.push(format!("record     {}", status.record_directory));
    lines.push(format!(
        "daemon     tactusd {} at {}",
        status.version, status.bus
    ));
    let lines: Vec<_> = lines.iter().map(|line| survey::printable(line)).collect();
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use dbus::json::{Health, Running};
    use survey::MapUnit;

    use crate::control::status::*;

    fn status() -> Status {
        Status {
            state: "acquiring".into(),
            simulated: true,
            source: "rig".into(),
            method: "one-step noser".into(),
            baseline: None,
            baseline_remarks: Vec::new(),
            session: Some(Running {
                id: "m1".into(),
                kind: "measurement".into(),
                state: "running".into(),
                frames_acquired: 8,
                frames_durable: 7,
                frames_dropped: 0,
                frames_failed: 0,
                last_error: None,
                map: Some(MapSummary {
                    sequence: 7,
                    unit: "relative loss of conductance",
                    largest_loss: Some(0.25),
                    significant: Some(true),
                    noise: Some(0.01),
                    newtons: None,
                    largest_kpa: None,
                    quality: Some("sound".into()),
                    known: None,
                    doubts: None,
                    reconstruction_s: Some(0.00125),
                    durable_s: Some(0.005),
                }),
            }),
            source_state: "in use".into(),
            recovery: None,
            record_directory: "/r".into(),
            last_error: None,
            version: "0.1.0".into(),
            bus: "unix:/p".into(),
            health: Health::default(),
        }
    }

    #[test]
    fn the_golden_line() {
        let mut printer = Printer::into(true, Vec::new());
        printer.record(&status(), for_a_person).unwrap();
        assert_eq!(
            String::from_utf8(printer.sink()).unwrap(),
            "{\"state\":\"acquiring\",\"simulated\":true,\"source\":\"rig\",\"method\":\"one-step noser\",\"baseline\":null,\"baseline_remarks\":[],\
             \"session\":{\"id\":\"m1\",\"kind\":\"measurement\",\"state\":\"running\",\"frames_acquired\":8,\
             \"frames_durable\":7,\"frames_dropped\":0,\"frames_failed\":0,\"last_error\":null,\"map\":{\"sequence\":7,\
             \"unit\":\"relative loss of conductance\",\"largest_loss\":0.25,\"significant\":true,\"noise\":0.01,\"newtons\":null,\"largest_kpa\":null,\
             \"quality\":\"sound\",\"doubts\":null,\"known\":null,\"reconstruction_s\":0.00125,\"durable_s\":0.005}},\"source_state\":\"in use\",\"recovery\":null,\
             \"record_directory\":\"/r\",\
             \"last_error\":null,\"version\":\"0.1.0\",\"bus\":\"unix:/p\",\"health\":{\"well\":false,\"troubles\":[],\
             \"last_frame\":null,\"period_s\":null,\"backlog\":null,\"gaps\":{\"failed\":0,\"dropped\":0,\"last\":null},\
             \"instruments\":[],\"baseline_age_s\":null,\"disk_free_bytes\":null,\"disk_bytes_per_day\":null,\
             \"disk_days\":null,\"relay\":null}}\n"
        );
    }

    #[test]
    fn units_of_the_json_are_those_of_maps() {
        let unit = |newtons| {
            let session = dbus::SessionStatus {
                map_sequence: Some(7),
                map: Some(dbus::MapDetails {
                    newtons,
                    ..dbus::MapDetails::default()
                }),
                ..dbus::SessionStatus::default()
            };
            Running::from(session).map.unwrap().unit
        };
        assert_eq!(unit(Some(1.0)), MapUnit::Pressure.label());
        assert_eq!(unit(None), MapUnit::RelativeConductance.caption());
    }

    #[test]
    fn status_names_what_is_simulated_and_what_to_do() {
        let text = for_a_person(&status());
        assert!(
            text.contains("SIMULATED") && text.contains("`tactus baseline record`"),
            "{text}"
        );
        assert!(
            text.contains("m1 (measurement, running): 7 frames recorded"),
            "{text}"
        );
    }

    #[test]
    fn a_warning_about_the_baseline_is_shown() {
        let mut status = status();
        status.baseline = Some("b1".into());
        status.baseline_remarks = vec!["a load".into(), "a contact".into()];
        let text = for_a_person(&status);
        let shown = "baseline   b1\n           warning: a load; 1 more: `tactus baseline show`\n";
        assert!(text.contains(shown), "{text}");
    }

    #[test]
    fn a_map_is_in_newtons_with_a_calibration_and_never_without() {
        let mut status = status();
        let text = for_a_person(&status);
        let loss =
            "map        frame 7: largest relative loss of conductance 0.250, computed in 1.250 ms";
        assert!(text.contains(loss), "{text}");
        assert!(!text.contains("kPa") && !text.contains(" N,"), "{text}");
        let map = status.session.as_mut().unwrap().map.as_mut().unwrap();
        (map.newtons, map.largest_kpa) = (Some(19.61), Some(15.6));
        let text = for_a_person(&status);
        assert!(
            text.contains("frame 7: 19.6 N, largest pressure 15.6 kPa"),
            "{text}"
        );
        assert!(!text.contains("loss"), "{text}");
        let map = status.session.as_mut().unwrap().map.as_mut().unwrap();
        map.noise = Some(0.3);
        let text = for_a_person(&status);
        assert!(text.contains("nothing above the noise (30 %)"), "{text}");
    }

    #[test]
    fn lost_rig_is_shown_with_its_attempts_and_the_next() {
        let mut status = status();
        status.state = "suspended".into();
        status.source_state = "unknown".into();
        status.recovery = Some(Recovery {
            what: "the connection to 6221 (tcp:h:1) was lost".into(),
            tries: 3,
            next_s: Some(1.6),
            person: false,
        });
        let text = for_a_person(&status);
        assert!(
            text.contains(
                "reconnecting, 3 attempts so far, the next in 1.6 s: the connection to 6221"
            ),
            "{text}"
        );
        status.recovery.as_mut().unwrap().person = true;
        assert!(for_a_person(&status).contains("`tactus instruments accept`"));
    }
}
