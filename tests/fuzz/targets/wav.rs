#![no_main]

holosonar_fuzz::reader!("wav");
