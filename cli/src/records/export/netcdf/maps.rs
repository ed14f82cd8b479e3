//! The maps of a netCDF file: the mesh by the UGRID conventions, and a map in each record.

use eit::Mesh;
use imaging::recorded::RecordedFrame;
use logbook::FrameRecord;
use netcdf3::DataType;

use super::layout::{Layout, RecordBytes};
use super::number;
use crate::failure::Failure;
use crate::maps::frame_maps::FrameMaps;
use crate::maps::reconstruction::Reconstruction;
use crate::output::complain;

/// Defines the variables that [`MapVariables::put`] writes into each record.
pub(super) fn records(
    layout: &mut Layout,
    reconstruction: &Reconstruction,
    sd: bool,
) -> Result<(), Failure> {
    let change = "relative change of conductance since the baseline";
    map_variable(layout, "map", change, "1")?;
    if reconstruction.is_calibrated() {
        map_variable(layout, "pressure", "pressure by the calibration", "kPa")?;
    }
    if sd {
        let deviation = "standard deviation of the change of ln conductance, NaN if the frame gives no information about it";
        map_variable(layout, "map_sd", deviation, "1")?;
    }
    Ok(())
}

fn map_variable(
    layout: &mut Layout,
    name: &str,
    meaning: &str,
    units: &str,
) -> Result<(), Failure> {
    let texts = [
        ("long_name", meaning),
        ("units", units),
        ("mesh", "mesh"),
        ("location", "face"),
    ];
    layout.variable(name, &["time", "triangle"], DataType::F64, &texts)
}

/// Defines the mesh. Its faces are the triangles of the region, which have a value in each map.
pub(super) fn mesh(layout: &mut Layout, mesh: &Mesh) -> Result<(), Failure> {
    layout.dimension("node", mesh.nodes().len())?;
    layout.dimension("triangle", mesh.region().len())?;
    layout.dimension("corner", 3)?;
    layout.whole_numbers(
        "mesh",
        &[],
        vec![0],
        &[
            ("cf_role", "mesh_topology"),
            ("long_name", "triangles of the sheet"),
            ("node_coordinates", "node_x node_y"),
            ("face_node_connectivity", "triangle_nodes"),
            ("face_dimension", "triangle"),
        ],
    )?;
    layout.count("mesh", "topology_dimension", 2)?;
    for (name, axis) in [("node_x", 0), ("node_y", 1)] {
        let positions = mesh.nodes().iter().map(|node| node[axis]).collect();
        layout.numbers(name, &["node"], positions, &[("units", "m")])?;
    }
    let corners = mesh.region().iter().flat_map(|&one| mesh.triangles()[one]);
    layout.whole_numbers(
        "triangle_nodes",
        &["triangle", "corner"],
        corners.map(number).collect(),
        &[
            ("cf_role", "face_node_connectivity"),
            ("long_name", "nodes of each triangle, counter-clockwise"),
        ],
    )?;
    layout.count("triangle_nodes", "start_index", 0)?;
    layout.whole_numbers(
        "element",
        &["triangle"],
        mesh.region().iter().copied().map(number).collect(),
        &[(
            "long_name",
            "number of the triangle in the mesh, from 0, as in elems.csv",
        )],
    )
}

/// Writes the maps of the frames.
pub(super) struct MapVariables<'a> {
    maps: FrameMaps<'a>,
    calibrated: bool,
    sd: bool,
    triangles: usize,
    made: usize,
}

impl<'a> MapVariables<'a> {
    /// `sd`: whether `maps` have standard deviations.
    pub(super) fn new(maps: FrameMaps<'a>, reconstruction: &Reconstruction, sd: bool) -> Self {
        Self {
            maps,
            sd,
            calibrated: reconstruction.is_calibrated(),
            triangles: reconstruction.mesh().region().len(),
            made: 0,
        }
    }

    /// Number of frames that have a map.
    pub(super) fn made(&self) -> usize {
        self.made
    }

    pub(super) fn put(
        &mut self,
        bytes: &mut RecordBytes,
        record: &FrameRecord,
    ) -> Result<(), Failure> {
        let frame = RecordedFrame {
            sequence: record.frame.sequence,
            label: record.frame.sequence.to_string(),
            wall: Some(record.frame.wall),
            readings: record.frame.readings.clone(),
            map: None,
        };
        let unknown = || std::iter::repeat_n(f64::NAN, self.triangles);
        let of_frame = self.maps.attempt(&frame)?;
        // the voltages of a frame without a map are still exported
        let of_frame = of_frame
            .map_err(|why| {
                complain(&format!(
                    "tactus: frame {} has no map: {why}",
                    frame.sequence
                ))
            })
            .ok();
        self.made += usize::from(of_frame.is_some());
        let (map, pressure, deviation) = match of_frame {
            Some(of_frame) => (
                Some(of_frame.map.values),
                of_frame.pressure.map(|pressure| pressure.kpa),
                of_frame.deviation,
            ),
            None => (None, None, None),
        };
        let values = [
            Some(map),
            self.calibrated.then_some(pressure),
            self.sd.then_some(deviation),
        ];
        for values in values.into_iter().flatten() {
            match values {
                Some(values) => bytes.reals(values),
                None => bytes.reals(unknown()),
            }
        }
        Ok(())
    }
}
