//! The introspection data of the running daemon equal the XML in the repository.

use dbus::Address;

use crate::test_rig::{self, Needs, ask, baseline};

/// One `<interface>` of introspection data, its lines trimmed and in order of appearance.
fn interface(xml: &str, name: &str) -> Option<String> {
    let begin = xml.find(&format!("<interface name=\"{name}\""))?;
    let end = begin + xml[begin..].find("</interface>")? + "</interface>".len();
    let mut comment = false;
    let lines: Vec<&str> = xml[begin..end]
        .lines()
        .map(str::trim)
        .filter(|line| {
            // documentation comments may be reworded without breaking the contract
            let inside = comment || line.starts_with("<!--");
            comment = inside && !line.ends_with("-->");
            !inside && !line.is_empty()
        })
        .collect();
    Some(lines.join("\n"))
}

#[test]
fn introspection_matches_the_kept_xml() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    baseline(&stage, 2);
    let id = ask(&stage, &["start", "--step"])[0]["session"]
        .as_str()
        .expect("an id")
        .to_owned();
    test_rig::runtime().block_on(async {
        let (connection, _) = dbus::connect(Some(&Address::Unix(stage.peer_path())))
            .await
            .expect("the daemon listens");
        let introspect = async |path: &str| -> String {
            let reply = connection
                .call_method(
                    Some(dbus::BUS_NAME),
                    path,
                    Some("org.freedesktop.DBus.Introspectable"),
                    "Introspect",
                    &(),
                )
                .await
                .expect("every object can be asked");
            reply.body().deserialize().expect("a text")
        };
        let instruments = dbus::Manager1Proxy::new(&connection)
            .await
            .expect("the manager is there")
            .instruments()
            .await
            .expect("instruments are listed");
        let session = dbus::session_path(&id).expect("an id makes a path");
        for (name, kept) in dbus::INTERFACE_XML {
            let path = match name {
                dbus::INSTRUMENT_INTERFACE => instruments[0].as_str(),
                dbus::SESSION_INTERFACE => session.as_str(),
                _ => dbus::ROOT_PATH,
            };
            let shown = introspect(path).await;
            let shown = interface(&shown, name)
                .unwrap_or_else(|| panic!("{path} does not show {name}:\n{shown}"));
            let kept = interface(kept, name)
                .unwrap_or_else(|| panic!("the repository does not keep {name}"));
            assert_eq!(shown, kept, "{name} at {path}");
        }
    });
}
