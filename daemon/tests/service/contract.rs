//! The interfaces of the running daemon are those in `dbus/xml`.

use std::collections::BTreeMap;

use crate::stage::{SMALL, Stage, within};
use dbus::{INTERFACE_XML, Options, ROOT_PATH};
use zbus::fdo::IntrospectableProxy;

/// The interfaces of Tactus in introspection data, each from its tag to its end.
fn interfaces(xml: &str) -> BTreeMap<String, String> {
    xml.split_inclusive("</interface>")
        .filter_map(|part| {
            let text = &part[part.find("<interface name=\"org.tactus.")?..];
            let name = text.split('"').nth(1)?.to_owned();
            Some((name, unindented(text)))
        })
        .collect()
}

fn unindented(text: &str) -> String {
    let mut lines: Vec<&str> = text.lines().map(str::trim).collect();
    lines.retain(|line| !line.is_empty());
    lines.join("\n")
}

#[tokio::test(flavor = "multi_thread")]
async fn introspection_equals_the_xml() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let session = daemon
        .manager
        .record_baseline(&Options::new().with("frames", 1_u64))
        .await
        .unwrap();
    let instrument = daemon.manager.instruments().await.unwrap()[0].clone();
    let mut shown = BTreeMap::new();
    for path in [ROOT_PATH, instrument.as_str(), session.as_str()] {
        let object = IntrospectableProxy::builder(&daemon.connection)
            .destination(dbus::BUS_NAME)
            .path(path.to_owned())
            .build()
            .await
            .unwrap();
        shown.extend(interfaces(&within(object.introspect()).await.unwrap()));
    }
    if std::env::var_os("TACTUS_WRITE_XML").is_some() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../dbus/xml");
        for (name, text) in &shown {
            let indented = indented(text);
            std::fs::write(format!("{folder}/{name}.xml"), indented).unwrap();
        }
        return;
    }
    let kept: BTreeMap<String, String> = INTERFACE_XML
        .iter()
        .flat_map(|(_, xml)| interfaces(xml))
        .collect();
    assert_eq!(kept.len(), INTERFACE_XML.len());
    for (name, text) in &kept {
        assert_eq!(
            Some(text),
            shown.get(name),
            "{name} differs; if the change is meant, run this test with TACTUS_WRITE_XML=1"
        );
    }
    assert_eq!(kept.len(), shown.len());
}

/// A node with the interface, two spaces for each level.
fn indented(text: &str) -> String {
    let mut out = String::from(
        "<!DOCTYPE node PUBLIC \"-//freedesktop//DTD D-BUS Object Introspection 1.0//EN\"\n \
         \"http://www.freedesktop.org/standards/dbus/1.0/introspect.dtd\">\n<node>\n",
    );
    let mut level = 1;
    let mut comment = false;
    for line in text.lines() {
        if line.starts_with("</") {
            level -= 1;
        }
        let deeper = usize::from(comment && line != "-->");
        out.push_str(&format!("{}{line}\n", "  ".repeat(level + deeper)));
        comment = (comment || line.starts_with("<!--")) && !line.ends_with("-->");
        let opens = line.starts_with('<')
            && !line.starts_with("</")
            && !line.starts_with("<!")
            && !line.ends_with("/>");
        level += usize::from(opens && !comment);
    }
    out.push_str("</node>\n");
    out
}

#[tokio::test(flavor = "multi_thread")]
async fn the_object_manager_lists_everything() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let manager = zbus::fdo::ObjectManagerProxy::builder(&daemon.connection)
        .destination(dbus::BUS_NAME)
        .path(ROOT_PATH)
        .build()
        .await
        .unwrap();
    let objects = within(manager.get_managed_objects()).await.unwrap();
    let mut paths: Vec<String> = objects
        .keys()
        .map(|path| path.as_str().to_owned())
        .collect();
    paths.sort();
    let expected = [
        "instrument/source",
        "instrument/switch_voltmeter",
        "session/b",
    ];
    for part in expected {
        assert!(
            paths
                .iter()
                .any(|path| path.starts_with(&format!("{ROOT_PATH}/{part}"))),
            "{part} is not among {paths:?}"
        );
    }
}
