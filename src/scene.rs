//! stub
#![allow(missing_docs)]
use crate::error::Result;
use glam::DVec3;
#[derive(Debug, Clone)]
pub struct Material {
    pub name: String,
    pub reflectance: f64,
    pub transmittance: f64,
    pub source: String,
}
#[derive(Debug, Clone, Copy)]
pub struct Triangle {
    pub vertices: [DVec3; 3],
    pub material: u32,
}
impl Triangle {
    pub fn cross(&self) -> DVec3 {
        let [a, b, c] = self.vertices;
        (b - a).cross(c - a)
    }
    pub fn area(&self) -> f64 {
        self.cross().length() * 0.5
    }
    pub fn normal(&self) -> DVec3 {
        self.cross().normalize_or_zero()
    }
}
#[derive(Debug)]
pub struct Scene {
    t: Vec<Triangle>,
    m: Vec<Material>,
}
#[derive(Debug, Clone, Copy)]
pub struct Crossing {
    pub distance: f64,
    pub triangle: u32,
    pub transmittance: f64,
}
impl Scene {
    pub fn new(t: Vec<Triangle>, m: Vec<Material>) -> Result<Self> {
        Ok(Self { t, m })
    }
    pub fn triangles(&self) -> &[Triangle] {
        &self.t
    }
    pub fn materials(&self) -> &[Material] {
        &self.m
    }
    pub fn surface_area(&self) -> f64 {
        self.t.iter().map(Triangle::area).sum()
    }
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        Some(
            self.t
                .iter()
                .flat_map(|t| t.vertices)
                .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v))),
        )
    }
    pub fn transmittance(&self, from: DVec3, to: DVec3) -> f64 {
        self.crossings(from, to).iter().map(|c| c.transmittance).product()
    }
    pub fn crossings(&self, from: DVec3, to: DVec3) -> Vec<Crossing> {
        let d = to - from;
        let len = d.length();
        let mut out: Vec<Crossing> = vec![];
        for (i, t) in self.t.iter().enumerate() {
            let [a, b, c] = t.vertices;
            let n = t.cross();
            let den = n.dot(d);
            if den == 0.0 {
                continue;
            }
            let s = n.dot(a - from) / den;
            if s * len < 1e-6 || s * len > len - 1e-6 {
                continue;
            }
            let p = from + d * s;
            let e = |u: DVec3, v: DVec3| (v - u).cross(p - u).dot(n);
            if e(a, b) >= 0.0 && e(b, c) >= 0.0 && e(c, a) >= 0.0 {
                out.push(Crossing {
                    distance: s * len,
                    triangle: i as u32,
                    transmittance: self.m[t.material as usize].transmittance,
                });
            }
        }
        out.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        out.dedup_by(|a, b| (a.distance - b.distance).abs() < 1e-6);
        out
    }
}
