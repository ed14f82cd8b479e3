//! Writing of case folders.

use std::path::Path;

use outfile::Existing;

use super::text::{digits, line};
use super::{Case, CaseError, DEPTH, protocol_text};

impl Case {
    /// Writes the folder, and creates it if needed. If a case is replaced, its region, depth and unloaded conductance
    /// are removed.
    ///
    /// # Errors
    /// A file that cannot be written, or exists and must not be replaced.
    pub fn write(&self, folder: &Path, existing: Existing) -> Result<(), CaseError> {
        outfile::make_folder(folder, Existing::Replace)?;
        let put = |name: &str, text: String| {
            outfile::write(&folder.join(name), existing, text.as_bytes())
        };
        let mut text = String::from("x_m,y_m\n");
        for [x, y] in self.mesh.nodes() {
            line(&mut text, &[digits(*x), digits(*y)]);
        }
        put("nodes.csv", text)?;
        let mut text = String::from("n0,n1,n2\n");
        for triangle in self.mesh.triangles() {
            line(&mut text, &triangle.map(|node| node.to_string()));
        }
        put("elems.csv", text)?;
        let mut text = String::from("electrode,node_a,node_b\n");
        for (electrode, edges) in self.mesh.electrode_edges().iter().enumerate() {
            for [a, b] in edges {
                line(
                    &mut text,
                    &[electrode, *a, *b].map(|value| value.to_string()),
                );
            }
        }
        put("electrode_edges.csv", text)?;
        let mut text = String::from("electrode,z_contact_ohm_m,length_m,centre_x_m,centre_y_m\n");
        for (electrode, (z, [x, y])) in self
            .contact_ohm_m
            .iter()
            .zip(self.mesh.electrode_centres())
            .enumerate()
        {
            let length = self.mesh.electrode_length(electrode);
            line(
                &mut text,
                &[
                    electrode.to_string(),
                    digits(*z),
                    digits(length),
                    digits(x),
                    digits(y),
                ],
            );
        }
        put("electrodes.csv", text)?;
        put(
            "protocol.csv",
            protocol_text(&self.protocol, &self.currents),
        )?;
        // files of an earlier case that this case does not have would be read as part of it
        let absent = |name: &str| outfile::remove(&folder.join(name), existing);
        if self.has_region {
            let mut text = String::from("element\n");
            for element in self.mesh.region() {
                line(&mut text, &[element.to_string()]);
            }
            put("roi.csv", text)?;
        } else {
            absent("roi.csv")?;
        }
        if !self.sigma.contains_key("homog") {
            absent("sigma_homog.csv")?;
        }
        if let Some(depth) = self.mesh.depth() {
            let mut text = String::from(
                "depth_m,electrode_height_m,electrode_centre_m,modes,target_height_m\n",
            );
            line(&mut text, &depth.numbers().map(digits));
            put(DEPTH, text)?;
        } else {
            absent(DEPTH)?;
        }
        for (name, sigma) in &self.sigma {
            let mut text = String::from("sigma_S_per_sq\n");
            for value in sigma {
                line(&mut text, &[digits(*value)]);
            }
            put(&format!("sigma_{name}.csv"), text)?;
        }
        Ok(())
    }

    /// Removes mesh, contacts, region, depth and unloaded conductance of an earlier case in a folder that is written without a mesh.
    ///
    /// # Errors
    /// A file that cannot be removed, or exists and must not be replaced.
    pub fn remove_mesh(folder: &Path, existing: Existing) -> Result<(), CaseError> {
        for name in [
            "nodes.csv",
            "elems.csv",
            "electrode_edges.csv",
            "electrodes.csv",
            "roi.csv",
            "sigma_homog.csv",
            DEPTH,
        ] {
            outfile::remove(&folder.join(name), existing)?;
        }
        Ok(())
    }
}
