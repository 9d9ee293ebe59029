// The pictures of the cameras with the samples of the map on top.

import { fitColour, fitGradient, fresh } from "./drawing.js";

const BINS = 12;

export class CameraView {
  constructor(root, legend) {
    this.root = root;
    this.legend = legend;
    this.figures = [];
    new ResizeObserver(() => this.layOut()).observe(root);
  }

  // One figure for each camera of the scene.
  open(scene, kind) {
    this.scene = scene;
    this.root.replaceChildren();
    this.figures = scene.cameras.map((camera) => {
      const figure = document.createElement("figure"), image = new Image(), canvas = document.createElement("canvas");
      const caption = document.createElement("figcaption");
      caption.textContent = camera.name;
      image.alt = `${camera.name} camera`;
      figure.append(image, canvas, caption);
      this.root.append(figure);
      return { figure, image, canvas, camera };
    });
    this.show(kind);
    this.layOut();
  }

  show(kind) {
    for (const { image, camera } of this.figures) {
      const shown = camera.pictures.includes(kind) ? kind : camera.pictures[0];
      image.src = `api/picture/${this.scene.frame}/${shown}/${encodeURIComponent(camera.name)}`;
    }
  }

  // As large as fits: the number of columns that gives the widest pictures.
  layOut() {
    if (!this.figures.length) return;
    const { clientWidth: width, clientHeight: height } = this.root, count = this.figures.length, gap = 6;
    let best = { size: 0, columns: 1 };
    for (let columns = 1; columns <= count; columns++) {
      const rows = Math.ceil(count / columns);
      const ratio = Math.max(...this.figures.map(({ camera }) => camera.height / camera.width));
      const size = Math.min((width - gap * (columns - 1)) / columns, (height - gap * (rows - 1)) / rows / ratio);
      if (size > best.size) best = { size, columns };
    }
    this.root.style.gridTemplateColumns = `repeat(${best.columns}, auto)`;
    for (const { figure, camera } of this.figures) {
      figure.style.width = `${Math.floor(best.size)}px`;
      figure.style.height = `${Math.floor((best.size * camera.height) / camera.width)}px`;
    }
    if (this.last) this.draw(...this.last);
  }

  draw(answer, colouring, rampPx) {
    this.last = [answer, colouring, rampPx];
    const { uv, slope, residual, weight, in_view, channel } = answer.arrays;
    const count = weight.shape[1], bins = colouring === "class" ? this.scene.channels.length : BINS;
    this.figures.forEach(({ canvas, camera }, index) => {
      const { g, width } = fresh(canvas);
      const scale = width / camera.width, paths = Array.from({ length: bins + 1 }, () => new Path2D());
      const rim = new Path2D();
      for (let k = index * count; k < (index + 1) * count; k++) {
        if (in_view.data[k] <= 0) continue;
        const u = uv.data[2 * k] + 0.5, v = uv.data[2 * k + 1] + 0.5;
        if (u < -20 || v < -20 || u > camera.width + 20 || v > camera.height + 20) continue;
        const half = Math.min(Math.max(0.5 * in_view.data[k], 1.5), 5);
        const du = half * slope.data[2 * k], dv = half * slope.data[2 * k + 1];
        const seen = weight.data[k] > 0, share = Math.min(Math.abs(residual.data[k]), 0.999);
        const path = paths[!seen ? bins : colouring === "class" ? channel.data[k] : Math.floor(share * BINS)];
        for (const line of seen ? [rim, path] : [path]) {
          line.moveTo((u - du) * scale, (v - dv) * scale);
          line.lineTo((u + du) * scale, (v + dv) * scale);
        }
      }
      g.lineCap = "round";
      g.strokeStyle = "rgba(5,8,12,.75)";
      g.lineWidth = 3.6;
      g.stroke(rim);
      paths.forEach((path, bin) => {
        g.lineWidth = bin === bins ? 1.2 : 1.9;
        g.strokeStyle = bin === bins ? "rgba(190,200,212,.55)" : this.colour(colouring, bin);
        g.stroke(path);
      });
    });
    this.drawLegend(colouring, rampPx);
  }

  colour(colouring, bin) {
    return colouring === "class" ? this.scene.channels[bin].colour : fitColour(bin / (BINS - 1));
  }

  drawLegend(colouring, rampPx) {
    const key = `${colouring} ${rampPx}`;
    if (this.legend.dataset.key === key) return;
    this.legend.dataset.key = key;
    if (colouring === "class") {
      this.legend.textContent = "colours: see the table of classes";
      return;
    }
    const bar = document.createElement("span");
    bar.className = "bar";
    bar.style.background = fitGradient;
    this.legend.replaceChildren("0 px", bar, `${rampPx} px and more to the border`);
  }
}
