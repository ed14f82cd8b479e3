//! Any number in the configuration, an option or a D-Bus argument is either accepted, or rejected with its name, value
//! and range. It never ends a session.

use std::collections::HashMap;

use crate::stage::{Measuring, SMALL, Stage, reported, within};
use dbus::{Fault, MANAGER_INTERFACE, Options, ROOT_PATH, SESSION_INTERFACE};
use zbus::{Connection, OwnedVariant};

/// Numbers at the limits of their types, and the text for them in an error message.
fn extremes() -> Vec<(OwnedVariant, &'static str)> {
    let number = |number: f64| OwnedVariant::from(number);
    vec![
        (number(f64::INFINITY), "inf"),
        (number(f64::NEG_INFINITY), "-inf"),
        (number(f64::NAN), "NaN"),
        (number(1e308), "1e308"),
        (number(-1.0), "-1"),
        (number(0.0), "0"),
        (number(5e-324), "5e-324"),
        (number(1e15), "1e15"),
        (OwnedVariant::from(u64::MAX), ""),
        (OwnedVariant::from(i64::MAX), ""),
        (OwnedVariant::from(i64::MIN), ""),
        (OwnedVariant::from(-1_i64), "-1"),
        (OwnedVariant::from(0_u64), "0"),
    ]
}

/// Name and text of the error of a call; `None` if it succeeds.
async fn error<B>(
    client: &Connection,
    path: &str,
    interface: &str,
    method: &str,
    body: &B,
) -> Option<(String, String)>
where
    B: serde::Serialize + zbus::DynamicType + Sync,
{
    let call = client.call_method(None::<&str>, path, Some(interface), method, body);
    match within(call).await {
        Ok(_) => None,
        Err(zbus::Error::MethodError(name, text, _)) => {
            Some((name.to_string(), text.unwrap_or_default()))
        }
        Err(other) => panic!("{method}: {other}"),
    }
}

/// The options of a method, as listed in its error message.
async fn options_of(client: &Connection, path: &str, interface: &str, method: &str) -> Vec<String> {
    let requested = Options::new().with("no-such-option", 1.0);
    let answer = match method {
        "Discover" => {
            let nowhere: Vec<String> = Vec::new();
            error(client, path, interface, method, &(nowhere, requested)).await
        }
        _ => error(client, path, interface, method, &(requested,)).await,
    };
    let (_, text) = answer.expect("an unknown option is refused");
    let (_, known) = text
        .split_once("known are: ")
        .expect("it names the known ones");
    known
        .split(", ")
        .filter(|name| *name != "none")
        .map(str::to_owned)
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn an_option_with_any_number_is_refused_by_name_or_taken() {
    let measuring = Measuring::begin().await;
    // signals that nobody reads would delay the replies on this connection
    drop((measuring.happened, measuring.frames));
    let client = &measuring.daemon.connection;
    let session = measuring.session.inner().path().to_string();
    let (mut requested, mut names) = (0, 0);
    for (path, interface, method) in [
        (ROOT_PATH, MANAGER_INTERFACE, "StartSession"),
        (ROOT_PATH, MANAGER_INTERFACE, "RecordBaseline"),
        (ROOT_PATH, MANAGER_INTERFACE, "ListSessions"),
        (ROOT_PATH, MANAGER_INTERFACE, "PlanWith"),
        (ROOT_PATH, MANAGER_INTERFACE, "TestInstruments"),
        (ROOT_PATH, MANAGER_INTERFACE, "Relays"),
        (ROOT_PATH, MANAGER_INTERFACE, "Discover"),
        (ROOT_PATH, MANAGER_INTERFACE, "Transcript"),
        (session.as_str(), SESSION_INTERFACE, "OpenStream"),
    ] {
        for name in options_of(client, path, interface, method).await {
            names += 1;
            for (value, written) in extremes() {
                let mut options = HashMap::from([(name.clone(), value.try_clone().unwrap())]);
                let answer = if method == "Discover" {
                    // disables the search
                    for off in ["mdns", "broadcast"] {
                        options
                            .entry(off.to_owned())
                            .or_insert(OwnedVariant::from(false));
                    }
                    let nowhere: Vec<String> = Vec::new();
                    error(
                        client,
                        path,
                        interface,
                        method,
                        &(nowhere, Options(options)),
                    )
                    .await
                } else {
                    error(client, path, interface, method, &(Options(options),)).await
                };
                requested += 1;
                let Some((fault, text)) = answer else {
                    continue;
                };
                let what = format!("{method} {name} = {value:?}: {fault}: {text}");
                assert!(!text.contains("please report"), "{what}");
                if fault.ends_with("InvalidOption") {
                    let named = [format!("'{name}'"), format!("survey.{name}:")];
                    assert!(named.iter().any(|name| text.contains(name)), "{what}");
                    let ranged = [
                        "from ",
                        "none of ",
                        "one of ",
                        "above ",
                        "a whole number of",
                    ];
                    let by_range = ranged.iter().any(|word| text.contains(word));
                    // if another type is expected, the message names it
                    let by_kind = text.contains("must be a text") || text.contains("must be true");
                    // if the option is only for recordings, the message states only that
                    let elsewhere = text.contains("for recordings");
                    assert!(by_range || by_kind || elsewhere, "{what}");
                    let valued = text.contains(written) || text.contains("must be a whole number");
                    assert!(by_kind || elsewhere || valued, "{what}");
                } else {
                    // the value was accepted: the error is due to the running session, or its baseline
                    let taken = ["SessionActive", "BaselineMismatch"];
                    assert!(taken.iter().any(|name| fault.ends_with(name)), "{what}");
                }
            }
        }
    }
    assert!(
        names > 25 && requested > 300,
        "{names} options, {requested} calls"
    );

    let step = "Step";
    for frames in [0, u64::MAX] {
        let (fault, text) = error(client, &session, SESSION_INTERFACE, step, &(frames,))
            .await
            .expect("it has a schedule");
        assert!(
            fault.ends_with("InvalidOption") && text.contains("frames"),
            "{text}"
        );
    }
    let state = measuring.session.state().await.unwrap();
    assert!(
        ["running", "suspended"].contains(&state.as_str()),
        "{state}"
    );
    within(measuring.session.stop()).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_load_with_any_number_is_refused_by_name_or_taken() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("every_s", 0.0)).await;
    let simulation = daemon.simulation().await;
    let whole = [f64::INFINITY, f64::NEG_INFINITY, f64::NAN, 1e308, -1e308];
    for value in whole {
        for (name, [x, y, size, loss]) in [
            ("x_m", [value, 0.0, 0.03, 0.5]),
            ("y_m", [0.0, value, 0.03, 0.5]),
            ("size_m", [0.0, 0.0, value, 0.5]),
            ("loss", [0.0, 0.0, 0.03, value]),
        ] {
            let refused = within(simulation.press("disc", x, y, size, loss)).await;
            assert!(
                matches!(&refused, Err(Fault::InvalidOption(text)) if text.contains(name)),
                "{name} = {value}: {refused:?}"
            );
        }
    }
    for small in [0.0, -1.0, 5e-324] {
        for shape in ["disc", "rectangle", "triangle", "figure-eight"] {
            // accepted or rejected
            let _ = within(simulation.press(shape, small, small, small, 0.5)).await;
        }
    }
    let mut frames = session.receive_frame_done().await.unwrap();
    for _ in 0..2 {
        within(dbus::next(&mut frames)).await.unwrap();
    }
    assert_eq!(session.state().await.unwrap(), "running");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_note_of_more_than_four_kilobytes_is_refused() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    for name in ["note", "sheet", "foam", "ink", "operator"] {
        let options = || Options::new().with(name, "n".repeat(4097));
        for refused in [
            daemon.manager.start_session(&options()).await,
            daemon.manager.record_baseline(&options()).await,
        ] {
            assert!(
                matches!(&refused, Err(Fault::InvalidOption(text))
                         if text.contains(name) && text.contains("4097") && text.contains("4096")),
                "{refused:?}"
            );
        }
    }
    let longest = Options::new()
        .with("frames", 1_u64)
        .with("note", "n".repeat(4096));
    daemon.manager.record_baseline(&longest).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reload_with_any_number_leaves_the_session_running() {
    let mut measuring = Measuring::begin().await;
    // signals that nobody reads would delay the replies on this connection
    drop(measuring.frames);
    let sound = std::fs::read_to_string(measuring.stage.config()).unwrap();
    for value in ["inf", "nan", "1e308", "-1", "5e-324"] {
        let bad = sound.replace("[survey]\n", &format!("[survey]\nnplc = {value}\n"));
        assert_ne!(bad, sound);
        measuring.stage.configure(&bad);
        measuring.daemon.hang_up();
        let text = reported(&mut measuring.happened, "reload-refused").await;
        assert!(
            text.contains("survey.nplc") && text.contains("none of 0.02"),
            "{text}"
        );
        let state = measuring.session.state().await.unwrap();
        assert!(
            ["running", "suspended"].contains(&state.as_str()),
            "{state}"
        );
    }
    // if the number is in the configuration at the start, the daemon exits with a code for which systemd does not retry
    for value in ["inf", "nan", "1e308"] {
        let stage =
            Stage::new(&SMALL.replace("[survey]\n", &format!("[survey]\nnplc = {value}\n")));
        let output = stage.run(&[]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(78), "{message}");
        assert!(
            message.contains("config.toml:") && message.contains("survey.nplc"),
            "{message}"
        );
    }
}
