#![no_main]

holosonar_fuzz::reader!("glb");
