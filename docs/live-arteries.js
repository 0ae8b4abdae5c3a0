// A network as its native FMU runs it, in WebAssembly: the host of the engine in a page. All values are in SI units.
"use strict";
(() => {
  const REAL = 0, ENUMERATION = 1;

  async function unpacked(text) {
    const packed = new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))]);
    return new Response(packed.stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
  }

  class Arteries {
    // The module of docs/live.py's engine, for any number of networks.
    static async engine(packed) {
      return WebAssembly.compile(await unpacked(packed));
    }

    // network : what docs/live.py says of it. It begins in its periodic beat.
    static async open(engine, network) {
      const resource = new Uint8Array(await unpacked(network.resource));
      const page = {
        size: () => resource.length,
        read: (at) => new Uint8Array(made.exports.memory.buffer).set(resource, at),
      };
      const made = await WebAssembly.instantiate(engine, { page });
      made.exports._initialize();
      return new Arteries(made.exports, network);
    }

    constructor(calls, network) {
      this.calls = calls;
      this.network = network;
      this.vrs = calls.malloc(4 * 1024);
      this.values = calls.malloc(8 * 1024);
      this.component = calls.component_new(this.text(""), this.text(""), this.vrs, 1024);
      if (!this.component) throw new Error(this.read(this.vrs));
      this.begin();
    }

    begin() {
      const { calls, component } = this;
      calls.component_reset(component);
      this.time = 0;
      for (const [vr, value] of this.network.first) this.write([vr], [value], ENUMERATION);
      for (const call of ["enter", "leave"]) this.done(calls[`component_${call}`](component));
    }

    // Parameters and inputs by their value references.
    write(vr, values, kind = REAL) {
      const { memory, component_write } = this.calls;
      new Uint32Array(memory.buffer, this.vrs, vr.length).set(vr);
      new Float64Array(memory.buffer, this.values, vr.length).set(values);
      this.done(component_write(this.component, this.vrs, vr.length, kind, this.values));
    }

    // The variables vr at the end of each step of the next beat, which takes T seconds : (steps, vr.length).
    beat(T, vr) {
      const { memory, component_write, component_step, component_read } = this.calls;
      const { inflow, inlet } = this.network, h = T / inflow.length, begin = this.time;
      const inletAt = this.vrs, outputsAt = this.vrs + 4;
      new Uint32Array(memory.buffer, inletAt, 1 + vr.length).set([inlet, ...vr]);
      return inflow.map((Q, k) => {
        new Float64Array(memory.buffer, this.values, 1)[0] = Q;
        this.done(component_write(this.component, inletAt, 1, REAL, this.values));
        this.done(component_step(this.component, this.time, h));
        this.time = begin + (k + 1) * h;
        this.done(component_read(this.component, outputsAt, vr.length, REAL, this.values));
        return Array.from(new Float64Array(memory.buffer, this.values, vr.length));
      });
    }

    done(status) {
      if (status <= 0) throw new Error(this.read(this.calls.component_said(this.component)));
    }

    read(at) {
      const bytes = new Uint8Array(this.calls.memory.buffer, at, 1024);
      return new TextDecoder().decode(bytes.subarray(0, bytes.indexOf(0)));
    }

    text(words) {
      const bytes = new TextEncoder().encode(`${words}\0`), at = this.calls.malloc(bytes.length);
      new Uint8Array(this.calls.memory.buffer).set(bytes, at);
      return at;
    }
  }

  globalThis.Arteries = Arteries;
})();
