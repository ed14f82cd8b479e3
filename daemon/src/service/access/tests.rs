use std::collections::BTreeSet;

use super::*;

/// Values of an attribute of every element of a kind whose tag contains this text.
fn named<'a>(xml: &'a str, element: &str, containing: &str) -> Vec<&'a str> {
    let opening = format!("<{element} name=\"");
    xml.split(&opening)
        .skip(1)
        .filter(|rest| {
            rest.split('>')
                .next()
                .is_some_and(|tag| tag.contains(containing))
        })
        .filter_map(|rest| rest.split('"').next())
        .collect()
}

fn rows<'a>(table: &[(&'a str, &'a str, Action)]) -> BTreeSet<(&'a str, &'a str)> {
    let rows: BTreeSet<_> = table.iter().map(|(of, member, _)| (*of, *member)).collect();
    assert_eq!(rows.len(), table.len(), "a row is there twice");
    rows
}

#[test]
fn every_method_and_every_property_to_set_has_its_row() {
    let mut methods = BTreeSet::new();
    let mut setters = BTreeSet::new();
    for (interface, xml) in bus::INTERFACE_XML {
        methods.extend(
            named(xml, "method", "")
                .into_iter()
                .map(|name| (interface, name)),
        );
        setters.extend(
            named(xml, "property", "write")
                .into_iter()
                .map(|name| (interface, name)),
        );
    }
    assert!(methods.contains(&(MANAGER_INTERFACE, "OpenAll")));
    assert_eq!(methods, rows(METHODS));
    assert_eq!(setters, rows(SETTERS));
    // the reading of the XML finds a property to set where there is one
    let xml = "<property name=\"A\" type=\"s\" access=\"readwrite\"/><property name=\"B\" access=\"read\"/>";
    assert_eq!(named(xml, "property", "write"), ["A"]);
}

#[test]
fn every_action_that_is_asked_about_is_declared_to_polkit() {
    let policy = include_str!("../../../../systemd/org.tactus.Tactus1.policy");
    let declared: BTreeSet<&str> = policy
        .split("<action id=\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .collect();
    let asked: BTreeSet<&str> = METHODS
        .iter()
        .chain(SETTERS)
        .filter_map(|(_, _, action)| action.id())
        .collect();
    assert_eq!(declared, asked);
    // the daemon is not root: polkit tells it about others only as the owner of the action
    let owners = policy
        .matches("<annotate key=\"org.freedesktop.policykit.owner\">")
        .count();
    assert_eq!(owners, declared.len());
    let rules = include_str!("../../../../systemd/org.tactus.Tactus1.rules");
    assert!(rules.contains("\"org.tactus.Tactus1.\"") && rules.contains("\"tactus\""));
}
