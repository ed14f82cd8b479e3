//! The target of every relative link in every page exists.

use std::collections::BTreeMap;

use super::pages;

#[test]
fn relative_links_and_anchors_exist() {
    let all = pages::all();
    let anchors: BTreeMap<_, _> = all
        .iter()
        .map(|page| {
            let path = page.folder().join(file_name(&page.path));
            (
                path.canonicalize().expect("the page was just read"),
                page.anchors(),
            )
        })
        .collect();
    let mut broken = Vec::new();
    let mut followed = 0;
    for page in &all {
        for (link, line) in page.links() {
            if is_elsewhere(&link) {
                continue;
            }
            followed += 1;
            let (path, fragment) = link.split_once('#').unwrap_or((&link, ""));
            let target = match path {
                "" => page.folder().join(file_name(&page.path)),
                path => page.folder().join(path),
            };
            let place = format!("{}:{line}", page.path);
            let Ok(target) = target.canonicalize() else {
                broken.push(format!("{place}: {link}: there is no such file"));
                continue;
            };
            let known = anchors.get(&target);
            if !fragment.is_empty()
                && !known.is_some_and(|known| known.iter().any(|anchor| anchor == fragment))
            {
                broken.push(format!("{place}: {link}: the page has no such heading"));
            }
        }
    }
    println!("{followed} relative links of {} pages followed", all.len());
    assert!(broken.is_empty(), "broken links:\n{}", broken.join("\n"));
}

#[test]
fn links_of_kept_html_pages_exist() {
    let mut broken = Vec::new();
    let mut kept = pages::files("html");
    kept.retain(|page| page.path.starts_with("docs/"));
    assert!(!kept.is_empty(), "the kept runs have pages");
    for page in &kept {
        for attribute in ["href=\"", "src=\""] {
            for rest in page.text.split(attribute).skip(1) {
                let link = rest.split('"').next().unwrap_or_default();
                if !is_elsewhere(link)
                    && !link.starts_with('#')
                    && !page.folder().join(link).exists()
                {
                    broken.push(format!("{}: {link}", page.path));
                }
            }
        }
    }
    assert!(broken.is_empty(), "broken links:\n{}", broken.join("\n"));
}

#[test]
fn every_page_of_the_manual_is_in_its_summary() {
    let all = pages::all();
    let summary = all
        .iter()
        .find(|page| page.path == "docs/SUMMARY.md")
        .expect("the manual has a summary");
    let listed: Vec<String> = summary
        .links()
        .into_iter()
        .map(|(link, _)| format!("docs/{link}"))
        .collect();
    for page in &all {
        if page.path.starts_with("docs/") && page.path != summary.path {
            assert!(
                listed.contains(&page.path),
                "{} is not listed in docs/SUMMARY.md",
                page.path
            );
        }
    }
}

fn is_elsewhere(link: &str) -> bool {
    link.contains("://") || link.starts_with("mailto:") || link.starts_with("data:")
}

fn file_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}
