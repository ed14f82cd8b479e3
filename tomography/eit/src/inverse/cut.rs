//! A minimum cut of a sparse graph: the augmenting-path method of Y. Boykov and V. Kolmogorov (IEEE Trans. Pattern
//! Anal. Mach. Intell. 26 (2004) 1124), which keeps two search trees and repairs them after each augmentation.

/// A graph with fixed edges; capacities are given for each cut.
pub(crate) struct CutGraph {
    /// Arcs of each node: `arcs[first[node]..first[node + 1]]`. Arc 2e goes along edge e, arc 2e + 1 against it.
    first: Vec<usize>,
    arcs: Vec<u32>,
    head: Vec<u32>,
}

/// Parent of a node: an arc, or one of these constants.
const NONE: u32 = u32::MAX;
const TERMINAL: u32 = u32::MAX - 1;
const ORPHAN: u32 = u32::MAX - 2;

/// State of one cut.
struct Flow<'a> {
    graph: &'a CutGraph,
    /// Residual capacity of each arc.
    left: Vec<f64>,
    /// Residual capacity from the source (positive) or to the sink (negative).
    terminal: Vec<f64>,
    parent: Vec<u32>,
    in_sink_tree: Vec<bool>,
    active: std::collections::VecDeque<u32>,
    queued: Vec<bool>,
    orphans: std::collections::VecDeque<u32>,
    /// Time at which a node's distance to its terminal was last confirmed, and that distance.
    stamp: Vec<u32>,
    distance: Vec<u32>,
    time: u32,
}

impl CutGraph {
    pub(crate) fn new(nodes: usize, edges: &[[usize; 2]]) -> Self {
        let mut first = vec![0_usize; nodes + 1];
        for edge in edges {
            for &end in edge {
                first[end + 1] += 1;
            }
        }
        for node in 0..nodes {
            first[node + 1] += first[node];
        }
        let mut next = first.clone();
        let mut arcs = vec![0; 2 * edges.len()];
        let mut head = vec![0; 2 * edges.len()];
        for (edge, &[a, b]) in edges.iter().enumerate() {
            for (arc, from, to) in [(2 * edge, a, b), (2 * edge + 1, b, a)] {
                arcs[next[from]] = arc as u32;
                next[from] += 1;
                head[arc] = to as u32;
            }
        }
        Self { first, arcs, head }
    }

    /// The neighbours of a node, in the order of the edges.
    pub(crate) fn neighbours(&self, node: usize) -> impl Iterator<Item = usize> + '_ {
        let arcs = &self.arcs[self.first[node]..self.first[node + 1]];
        arcs.iter().map(|&arc| self.head[arc as usize] as usize)
    }

    /// The set S that minimises  sum of `cost` over S + sum of `capacity` over edges with one end in S: the smallest
    /// such set, up to rounding. Capacities must not be negative.
    pub(crate) fn minimum(&self, cost: &[f64], capacity: &[f64]) -> Vec<bool> {
        let nodes = self.first.len() - 1;
        let mut flow = Flow {
            graph: self,
            left: capacity.iter().flat_map(|&c| [c, c]).collect(),
            terminal: cost.iter().map(|cost| -cost).collect(),
            parent: vec![NONE; nodes],
            in_sink_tree: vec![false; nodes],
            active: std::collections::VecDeque::new(),
            queued: vec![false; nodes],
            orphans: std::collections::VecDeque::new(),
            stamp: vec![0; nodes],
            distance: vec![0; nodes],
            time: 0,
        };
        flow.run();
        (0..nodes)
            .map(|node| flow.parent[node] != NONE && !flow.in_sink_tree[node])
            .collect()
    }
}

impl Flow<'_> {
    fn run(&mut self) {
        for node in 0..self.terminal.len() {
            if self.terminal[node] != 0.0 {
                self.in_sink_tree[node] = self.terminal[node] < 0.0;
                self.parent[node] = TERMINAL;
                self.distance[node] = 1;
                self.activate(node as u32);
            }
        }
        while let Some(&node) = self.active.front() {
            if self.parent[node as usize] != NONE
                && let Some(bridge) = self.grow(node)
            {
                self.time += 1;
                self.augment(bridge);
                while let Some(orphan) = self.orphans.pop_front() {
                    self.adopt(orphan);
                }
                continue; // the same node may reach others
            }
            self.active.pop_front();
            self.queued[node as usize] = false;
        }
    }

    fn activate(&mut self, node: u32) {
        if !std::mem::replace(&mut self.queued[node as usize], true) {
            self.active.push_back(node);
        }
    }

    /// Residual capacity of the arc away from the source, or towards the sink.
    fn outwards(&self, arc: u32, sink_tree: bool) -> f64 {
        self.left[(if sink_tree { arc ^ 1 } else { arc }) as usize]
    }

    /// Grows the tree from `node`; returns an arc from the source tree to the sink tree when they meet.
    fn grow(&mut self, node: u32) -> Option<u32> {
        let sink_tree = self.in_sink_tree[node as usize];
        for at in self.graph.first[node as usize]..self.graph.first[node as usize + 1] {
            let arc = self.graph.arcs[at];
            if self.outwards(arc, sink_tree) <= 0.0 {
                continue;
            }
            let other = self.graph.head[arc as usize] as usize;
            if self.parent[other] == NONE {
                self.in_sink_tree[other] = sink_tree;
                self.parent[other] = arc ^ 1;
                self.stamp[other] = self.stamp[node as usize];
                self.distance[other] = self.distance[node as usize] + 1;
                self.activate(other as u32);
            } else if self.in_sink_tree[other] != sink_tree {
                return Some(if sink_tree { arc ^ 1 } else { arc });
            } else if self.stamp[other] <= self.stamp[node as usize]
                && self.distance[other] > self.distance[node as usize]
            {
                // a shorter way to the terminal
                self.parent[other] = arc ^ 1;
                self.stamp[other] = self.stamp[node as usize];
                self.distance[other] = self.distance[node as usize] + 1;
            }
        }
        None
    }

    /// Sends the largest possible flow along the path through `bridge`; nodes whose arc to the parent is saturated
    /// become orphans.
    fn augment(&mut self, bridge: u32) {
        let tail = self.graph.head[(bridge ^ 1) as usize];
        let tip = self.graph.head[bridge as usize];
        let mut amount = self.left[bridge as usize];
        for (end, sink_tree) in [(tail, false), (tip, true)] {
            let mut node = end as usize;
            loop {
                let way = self.parent[node];
                if way == TERMINAL {
                    amount = amount.min(self.terminal[node].abs());
                    break;
                }
                // `way` leads from the node to its parent; flow goes from the source to the sink
                amount = amount.min(self.outwards(way ^ 1, sink_tree));
                node = self.graph.head[way as usize] as usize;
            }
        }
        self.left[bridge as usize] -= amount;
        self.left[(bridge ^ 1) as usize] += amount;
        for (end, sink_tree) in [(tail, false), (tip, true)] {
            let mut node = end as usize;
            loop {
                let way = self.parent[node];
                if way == TERMINAL {
                    self.terminal[node] -= if sink_tree { -amount } else { amount };
                    if self.terminal[node] == 0.0 {
                        self.orphan(node as u32);
                    }
                    break;
                }
                let along = if sink_tree { way } else { way ^ 1 };
                self.left[along as usize] -= amount;
                self.left[(along ^ 1) as usize] += amount;
                if self.left[along as usize] <= 0.0 {
                    self.orphan(node as u32);
                }
                node = self.graph.head[way as usize] as usize;
            }
        }
    }

    fn orphan(&mut self, node: u32) {
        self.parent[node as usize] = ORPHAN;
        self.orphans.push_front(node);
    }

    /// Finds a new parent for an orphan, or frees it and makes orphans of its children.
    fn adopt(&mut self, orphan: u32) {
        let sink_tree = self.in_sink_tree[orphan as usize];
        let arcs = self.graph.first[orphan as usize]..self.graph.first[orphan as usize + 1];
        let mut best = NONE;
        let mut nearest = u32::MAX;
        for at in arcs.clone() {
            let arc = self.graph.arcs[at];
            // in the source tree the arc to the orphan, in the sink tree the arc from it
            if self.outwards(arc ^ 1, sink_tree) <= 0.0 {
                continue;
            }
            let other = self.graph.head[arc as usize] as usize;
            if self.in_sink_tree[other] != sink_tree
                || self.parent[other] == NONE
                || self.parent[other] == ORPHAN
            {
                continue;
            }
            if let Some(distance) = self.distance_to_terminal(other)
                && distance < nearest
            {
                nearest = distance;
                best = arc;
            }
        }
        if best != NONE {
            self.parent[orphan as usize] = best;
            self.stamp[orphan as usize] = self.time;
            self.distance[orphan as usize] = nearest + 1;
            return;
        }
        self.parent[orphan as usize] = NONE;
        for at in arcs {
            let arc = self.graph.arcs[at];
            let other = self.graph.head[arc as usize];
            let (parent, same) = (
                self.parent[other as usize],
                self.in_sink_tree[other as usize] == sink_tree,
            );
            if !same || parent == NONE {
                continue;
            }
            if self.outwards(arc ^ 1, sink_tree) > 0.0 {
                self.activate(other);
            }
            if parent == (arc ^ 1) {
                self.parent[other as usize] = ORPHAN;
                self.orphans.push_back(other);
            }
        }
    }

    /// Distance of a node from its terminal, if its path still ends there; caches the distances found.
    fn distance_to_terminal(&mut self, node: usize) -> Option<u32> {
        let mut at = node;
        let mut steps = 0;
        let total = loop {
            if self.stamp[at] == self.time && self.time > 0 {
                break steps + self.distance[at];
            }
            match self.parent[at] {
                TERMINAL => {
                    self.stamp[at] = self.time;
                    self.distance[at] = 1;
                    break steps + 1;
                }
                ORPHAN | NONE => return None,
                way => {
                    steps += 1;
                    at = self.graph.head[way as usize] as usize;
                }
            }
        };
        let (mut at, mut distance) = (node, total);
        while self.stamp[at] != self.time {
            self.stamp[at] = self.time;
            self.distance[at] = distance;
            distance -= 1;
            at = self.graph.head[self.parent[at] as usize] as usize;
        }
        Some(total)
    }
}

#[cfg(test)]
mod tests {
    use crate::inverse::cut::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn value(set: &[bool], cost: &[f64], edges: &[[usize; 2]], capacity: &[f64]) -> f64 {
        let costs: f64 = set
            .iter()
            .zip(cost)
            .filter(|(s, _)| **s)
            .map(|(_, c)| c)
            .sum();
        let cut: f64 = edges
            .iter()
            .zip(capacity)
            .filter(|([a, b], _)| set[*a] != set[*b])
            .map(|(_, c)| c)
            .sum();
        costs + cut
    }

    /// Against every subset, on random graphs of up to 12 nodes with integer and fractional costs.
    #[test]
    fn no_set_is_better() {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        for round in 0..2000 {
            let nodes = random.random_range(1..=12);
            let mut edges = Vec::new();
            for a in 0..nodes {
                for b in a + 1..nodes {
                    if random.random::<f64>() < 0.35 {
                        edges.push([a, b]);
                    }
                }
            }
            let number = |random: &mut ChaCha8Rng, low: f64, high: f64| {
                let value = low + (high - low) * random.random::<f64>();
                if round % 2 == 0 { value.round() } else { value }
            };
            let cost: Vec<f64> = (0..nodes).map(|_| number(&mut random, -5.0, 5.0)).collect();
            let capacity: Vec<f64> = edges
                .iter()
                .map(|_| number(&mut random, 0.0, 4.0))
                .collect();
            let found = CutGraph::new(nodes, &edges).minimum(&cost, &capacity);
            let best = (0..1_usize << nodes)
                .map(|bits| {
                    let set: Vec<bool> = (0..nodes).map(|node| bits >> node & 1 == 1).collect();
                    value(&set, &cost, &edges, &capacity)
                })
                .fold(f64::INFINITY, f64::min);
            let own = value(&found, &cost, &edges, &capacity);
            assert!(
                own <= best + 1e-12,
                "round {round}: {own} instead of {best}"
            );
        }
    }

    /// A long grid, in which trees grow deep and break: its cut equals that of the mirrored grid.
    #[test]
    fn a_grid_has_one_minimum() {
        let (wide, high) = (40, 25);
        let at = |x: usize, y: usize| y * wide + x;
        let mut edges = Vec::new();
        for y in 0..high {
            for x in 0..wide {
                if x + 1 < wide {
                    edges.push([at(x, y), at(x + 1, y)]);
                }
                if y + 1 < high {
                    edges.push([at(x, y), at(x, y + 1)]);
                }
            }
        }
        let mut random = ChaCha8Rng::seed_from_u64(8);
        let cost: Vec<f64> = (0..wide * high)
            .map(|_| random.random::<f64>() - 0.5)
            .collect();
        let capacity: Vec<f64> = edges.iter().map(|_| 0.4 * random.random::<f64>()).collect();
        let own = CutGraph::new(wide * high, &edges).minimum(&cost, &capacity);
        // backwards: nodes numbered from the end, edges the other way round
        let turned: Vec<[usize; 2]> = edges
            .iter()
            .rev()
            .map(|[a, b]| [wide * high - 1 - b, wide * high - 1 - a])
            .collect();
        let back: Vec<f64> = cost.iter().rev().copied().collect();
        let caps: Vec<f64> = capacity.iter().rev().copied().collect();
        let other = CutGraph::new(wide * high, &turned).minimum(&back, &caps);
        let (a, b) = (
            value(&own, &cost, &edges, &capacity),
            value(&other, &back, &turned, &caps),
        );
        assert!((a - b).abs() < 1e-10 && a < -1.0, "{a} and {b}");
    }
}
